"""The engine: Snakemake, which runs the jobs of a workflow on this machine's cores or wherever one of its profiles says."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from calflow.files.writing import inside, write_whole
from calflow.fleet.robot_study import lacking

LOG = "snakemake.log"


@dataclass(frozen=True)
class Where:
    """Where jobs are to run: on cores of this machine or as a profile of Snakemake's says, and further options for it."""

    cores: int
    profile: str = ""
    options: tuple[str, ...] = ()


def check_engine() -> None:
    """Check that the library of the extra is there.

    Raises:
        InputError: it is not.
    """
    if find_spec("snakemake") is None:
        raise lacking("Snakemake")


def command(snakefile: Path, told: Mapping[str, object], folder: Path, where: Where) -> list[str]:
    """Return the call of Snakemake that runs a workflow in a folder; what it is told is kept there, to be used by hand too.

    Jobs that were stopped are done anew, and whoever calls sees to it that nobody else is at work in the folder: Snakemake need
    not keep its own lock, which outlives a process that is killed.

    Raises:
        InputError: a link in what Snakemake keeps there leads out of the folder.
    """
    kept = folder / ".snakemake"
    for path in (kept, *kept.rglob("*"), folder / LOG):
        inside(folder, path.relative_to(folder).as_posix())
    config = folder / "snakemake.json"
    write_whole(config, (json.dumps(told, indent=2) + "\n").encode())
    places = ["--profile", where.profile] if where.profile else ["--cores", str(where.cores)]
    return [
        sys.executable, "-m", "snakemake", "--snakefile", str(snakefile), "--configfile", str(config),
        "--directory", str(folder), "--keep-going", "--rerun-incomplete", "--nolock", *places, *where.options,
    ]  # fmt: skip


@contextmanager
def running(called: Sequence[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run Snakemake in a folder, with all it says in a file there, and see to it that it has ended."""
    with (folder / LOG).open("wb") as said:
        process = subprocess.Popen(called, stdout=said, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            process.wait()
