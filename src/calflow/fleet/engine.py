"""The workflow engine: Snakemake in a fleet's folder, with one process per robot, so that failures stay isolated."""

from __future__ import annotations

import fcntl
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
RETRIES = 1  # further attempts for a robot that failed
TABLE, TYPES, UNLIKE, CAUSES = "fleet.csv", "type_parameters.csv", "unlike.csv", "common_causes.csv"
FOLDERS = ("studies", "robots", "outcomes", "logs", "types")  # subfolders
REPORT, PAGE = "report.pdf", "report.html"


@dataclass(frozen=True)
class FleetFolder:
    """The paths in a fleet's folder, which may not exist yet; a link that leads out of it raises an InputError."""

    path: Path

    def study(self, robot: str) -> Path:
        """Return the path of a robot's study file, derived from its type's study."""
        return inside(self.path, f"studies/{robot}.toml")

    def run(self, robot: str) -> Path:
        """Return the path of a robot's run folder."""
        return inside(self.path, f"robots/{robot}")

    def outcome(self, robot: str) -> Path:
        """Return the path of a robot's outcome: its accuracy if calibrated, the reason if it failed."""
        return inside(self.path, f"outcomes/{robot}.json")

    def log(self, robot: str) -> Path:
        """Return the path of a robot's log."""
        return inside(self.path, f"logs/{robot}.log")

    def type_robot(self, type_: str) -> Path:
        """Return the path of the type's robot file with priors for a further robot, learnt from the calibrated ones."""
        return inside(self.path, f"types/{type_}.toml")

    @property
    def results(self) -> tuple[Path, ...]:
        """Paths of the tables and reports of the whole fleet."""
        return tuple(self.path / name for name in (TABLE, TYPES, UNLIKE, CAUSES, REPORT, PAGE))


def check_engine() -> None:
    """Check that Snakemake, of the extra `fleet`, is installed.

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
    """Return the command line of Snakemake for a workflow in a folder, and write its configuration there, for use by hand too.

    Jobs run on cores of this machine, or by a profile of Snakemake's; options are passed on to it. Interrupted jobs are
    repeated. The caller ensures exclusive use of the folder: Snakemake's own lock is switched off, as it outlives a process
    that is killed.

    Raises:
        InputError: a link in Snakemake's own files leads out of the folder.
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
def held(folder: Path) -> Iterator[int]:
    """Lock a folder's log, and yield the descriptor by which Snakemake keeps it if this process is killed; refuse a second lock."""
    with inside(folder, LOG).open("ab") as log:
        try:
            fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise refuse("Snakemake of a killed command is at work in this folder: wait, or end it", folder) from None
        except OSError:  # a file system without such locks
            pass
        yield log.fileno()


@contextmanager
def running(called: Sequence[str], folder: Path, lock: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run Snakemake in a folder, with its lock, its output in a log there, and wait for its end on leaving the context."""
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(called, stdout=log, stderr=subprocess.STDOUT, pass_fds=(lock,))
        try:
            yield process
        finally:
            process.wait()


def supervise(called: Sequence[str], log: Path, minutes: float) -> str:
    """Run a robot's process, with its output in a log, and return why it failed; empty if it did not."""
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
