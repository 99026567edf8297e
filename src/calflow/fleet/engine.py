"""The engine: Snakemake, which runs a fleet's jobs on this machine's cores or wherever one of its profiles says."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from calflow.files.writing import write_whole
from calflow.fleet.fleet import Fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.robot_study import lacking
from calflow.study import workflow_folder


@dataclass(frozen=True)
class Asked:
    """How a fleet is to be run: cores of this machine, robots in a job, a profile of Snakemake's, and further options for it."""

    cores: int
    batch: int
    profile: str = ""
    options: tuple[str, ...] = ()


def check_engine() -> None:
    """Check that the libraries of the extra are there.

    Raises:
        InputError: one is not.
    """
    for library, module in (("Snakemake", "snakemake"), ("tomli-w", "tomli_w")):
        if find_spec(module) is None:
            raise lacking(library)


def command(fleet: Fleet, folder: FleetFolder, asked: Asked) -> list[str]:
    """Return the call of Snakemake that runs a fleet; what it is told is kept in the fleet's folder, to be used by hand too.

    A robot's runs go on where they were stopped, and the fleet's folder is locked by calflow: Snakemake need not keep its own
    lock, which outlives a process that is killed.
    """
    told = {"fleet": str(fleet.path.resolve()), "out": str(folder.path), "batch": asked.batch}
    config = folder.path / "snakemake.json"
    write_whole(config, (json.dumps(told, indent=2) + "\n").encode())
    where = ["--profile", asked.profile] if asked.profile else ["--cores", str(asked.cores)]
    return [
        sys.executable, "-m", "snakemake", "--snakefile", str(workflow_folder() / "fleet.smk"), "--configfile", str(config),
        "--directory", str(folder.path), "--keep-going", "--rerun-incomplete", "--nolock", *where, *asked.options,
    ]  # fmt: skip


@contextmanager
def running(called: Sequence[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run Snakemake, with all it says in a file, and see to it that it has ended."""
    with log.open("wb") as said:
        process = subprocess.Popen(called, stdout=said, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            process.wait()
