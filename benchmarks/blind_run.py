"""What the blind benchmarks share: cases run by the fleet's engine, one bad case not ending the others, and their command line.

--out FILE.csv keeps the single cases, and in FILE.jobs what each job made: the same command goes on from there after a kill.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from calflow.files.writing import write_whole
from calflow.fleet.engine import LOG, check_engine, command, held, running
from calflow.runs.lock import locked

if TYPE_CHECKING:
    from blind_cases import Job

    from calflow.files.tables import Results
    from calflow.study import Study
    from hidden.case import Case

Row = dict[str, object]


@dataclass(frozen=True)
class Kind:
    """What is drawn, what is done with each case, and how it is told."""

    jobs: Callable[[int, np.random.Generator], Iterator[Job]]
    work: Callable[[Job], Row]
    tell: Callable[[pd.DataFrame], str]


def run_kind(description: str | None, kinds: Mapping[str, Kind]) -> None:
    """Run the kind of cases that the command line asks for and print its table; or, of a job's command line, do the job."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=sorted(kinds))
    parser.add_argument("number", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument(
        "--profile", default="", help="of Snakemake's, which says where jobs run; this machine by default"
    )
    parser.add_argument("--batch", type=int, default=10, help="cases in a job")
    parser.add_argument("--job", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    kind = kinds[asked.what]
    if asked.job is not None:
        _do(kind, asked)
        return
    with tempfile.TemporaryDirectory() as apart:
        folder = asked.out.with_suffix(".jobs").resolve() if asked.out else Path(apart)
        table = pd.DataFrame(_done(asked, folder))
    if asked.out:
        table.to_csv(asked.out, index=False)
    for message in table["failed"].dropna():
        print("failed:", message)
    whole = table[table["failed"].isna()]
    print(kind.tell(whole) if len(whole) else "no case went through")


def _do(kind: Kind, asked: argparse.Namespace) -> None:
    """Work on the cases of a job."""
    jobs = list(kind.jobs(asked.number, np.random.default_rng([asked.seed, *asked.what.encode()])))
    rows = [kind.work(job) for job in jobs[asked.job * asked.batch : (asked.job + 1) * asked.batch]]
    write_whole(asked.out, json.dumps(rows, default=lambda value: value.item()).encode())


def _done(asked: argparse.Namespace, folder: Path) -> list[Row]:
    """Have all jobs done in a folder, and return their rows in the order of the cases."""
    check_engine()
    folder.mkdir(parents=True, exist_ok=True)
    told = {"script": str(Path(sys.argv[0]).resolve())} | {
        name: getattr(asked, name) for name in ("what", "number", "seed", "batch")
    }
    called = command(Path(__file__).with_name("blind.smk"), told, folder, asked.processes, asked.profile)
    files = [folder / f"job_{k}.json" for k in range(-(-asked.number // asked.batch))]
    with locked(folder), held(folder) as lock, running(called, folder, lock) as process:
        if process.wait():
            missing = sum(not file.exists() for file in files)
            sys.exit(
                f"{missing} of {len(files)} jobs were not done:\n{(folder / LOG).read_text(encoding='utf-8', errors='replace')}"
            )
    return [row for file in files for row in json.loads(file.read_text(encoding="utf-8"))]


def guarded(work: Callable[[Path], Row], job: Job) -> Row:
    """Do a case's work in a folder of its own; where it fails the row says how."""
    started, case = time.time(), job.case
    known: Row = {"kind": job.kind, "size": job.size, "seed": job.seed, "robot": case.robot, "poses": case.poses,
                  "payloads": len(case.payloads), "markers": case.markers, "failed": None}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        try:
            known |= work(Path(folder))
        except Exception as error:  # one bad case must not end the others
            known["failed"] = f"{type(error).__name__}: {error} ({job})"
    return known | {"seconds": time.time() - started}


def run_case(folder: Path, case: Case, seed: int) -> tuple[Study, Results]:
    """Write a case and run its study; its run is in folder/run."""
    from calflow.runs.run import run  # which the parent of all jobs, and a job of none, need not load
    from calflow.study import load_study
    from hidden.case import write_case

    write_case(folder, case, np.random.default_rng(seed))
    study = load_study(folder)
    return study, run(study, folder / "run").results


def hidden_names(case: Case) -> Row:
    """Name what is hidden."""
    return {"hidden": " + ".join(f"{h.cause}:{h.joint}" for h in case.hidden)}
