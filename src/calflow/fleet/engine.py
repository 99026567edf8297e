"""The engine: Snakemake, at work in a fleet's folder, with a process a robot, so that what befalls one befalls no other."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from calflow.files.problems import refuse
from calflow.files.writing import inside, write_whole

LOG = "snakemake.log"
RETRIES = 1  # times that a robot that failed is tried again
TABLE, TYPES, UNLIKE, CAUSES = "fleet.csv", "type_parameters.csv", "unlike.csv", "common_causes.csv"
PARTS = ("studies", "robots", "outcomes", "logs", "types")  # folders in it
REPORT, PAGE = "report.pdf", "report.html"


@dataclass(frozen=True)
class FleetFolder:
    """A fleet's folder; its paths may not exist yet, and where a link leads out of it there is an InputError."""

    path: Path

    def study(self, robot: str) -> Path:
        """A robot's study file, written from its type's."""
        return inside(self.path, f"studies/{robot}.toml")

    def run(self, robot: str) -> Path:
        """A robot's run folder."""
        return inside(self.path, f"robots/{robot}")

    def outcome(self, robot: str) -> Path:
        """What came out for a robot: that it is calibrated and how well, or that it failed and why."""
        return inside(self.path, f"outcomes/{robot}.json")

    def log(self, robot: str) -> Path:
        """What a robot's run told, line by line."""
        return inside(self.path, f"logs/{robot}.log")

    def type_robot(self, type_: str) -> Path:
        """The type's robot file with what its calibrated robots let expect of a further one."""
        return inside(self.path, f"types/{type_}.toml")

    @property
    def results(self) -> tuple[Path, ...]:
        """The tables and the reports of the whole fleet."""
        return tuple(self.path / name for name in (TABLE, TYPES, UNLIKE, CAUSES, REPORT, PAGE))


def check_engine() -> None:
    """Check that the library of the extra is there.

    Raises:
        InputError: it is not.
    """
    if find_spec("snakemake") is None:
        raise refuse("a fleet needs Snakemake, which is not installed: pip install 'calflow[fleet]'")


def command(
    snakefile: Path,
    configuration: Mapping[str, object],
    folder: Path,
    cores: int,
    profile: str = "",
    options: Sequence[str] = (),
) -> list[str]:
    """Return the call of Snakemake that runs a workflow in a folder; its configuration is kept there, to be used by hand too.

    Jobs run on cores of this machine, or as a profile of Snakemake's says; options are further ones for it.
    Jobs that were stopped are done anew, and whoever calls sees to it that nobody else is at work in the folder: Snakemake need
    not keep its own lock, which outlives a process that is killed.

    Raises:
        InputError: a link in what Snakemake keeps there leads out of the folder.
    """
    kept = folder / ".snakemake"
    for path in (kept, *kept.rglob("*"), folder / LOG):
        inside(folder, path.relative_to(folder).as_posix())
    config = folder / "snakemake.json"
    write_whole(config, (json.dumps(configuration, indent=2) + "\n").encode())
    places = ["--profile", profile] if profile else ["--cores", str(cores)]
    return [
        sys.executable, "-m", "snakemake", "--snakefile", str(snakefile), "--configfile", str(config),
        "--directory", str(folder), "--keep-going", "--rerun-incomplete", "--nolock", *places, *options,
    ]  # fmt: skip


@contextmanager
def running(called: Sequence[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run Snakemake in a folder, with all it says in a file there, and see to it that it has ended."""
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(called, stdout=log, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            process.wait()


def supervise(called: Sequence[str], log: Path, minutes: float) -> str:
    """Run a robot's process, with all it says in a file; return why it failed, empty where it did not."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as stream:
        try:
            code = subprocess.run(called, stdout=stream, stderr=subprocess.STDOUT, timeout=60.0 * minutes).returncode
        except subprocess.TimeoutExpired:
            return (
                f"it had not ended after {minutes:g} minutes and was stopped; its log says how far it came, and "
                "'minutes_per_robot' in [fleet] gives it longer"
            )
    if code < 0:
        name = signal.Signals(-code).name
        return f"its process was ended by {name}: by hand, for want of memory, or by a fault of a library"
    if not code:
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return lines[-1] if lines else f"its process ended without a word, with code {code}"
