"""What the blind benchmarks share: cases run in parallel, one bad case not ending the others, and their command line."""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from blind_cases import Job

from calflow.files.results import Results
from calflow.runs.run import run
from calflow.study import Study, load_study
from hidden.case import Case, write_case

Row = dict[str, object]


@dataclass(frozen=True)
class Kind:
    """What is drawn, what is done with each case, and how it is told."""

    jobs: Callable[[int, np.random.Generator], Iterator[Job]]
    work: Callable[[Job], Row]
    tell: Callable[[pd.DataFrame], str]


def run_kind(description: str | None, kinds: Mapping[str, Kind]) -> None:
    """Run the kind of cases that the command line asks for, and print its table."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=sorted(kinds))
    parser.add_argument("number", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    kind = kinds[asked.what]
    jobs = list(kind.jobs(asked.number, np.random.default_rng([asked.seed, *asked.what.encode()])))
    started, rows = time.time(), list[Row]()
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for row in pool.imap_unordered(kind.work, jobs):
            rows.append(row)
            if asked.out:
                pd.DataFrame(rows).to_csv(asked.out, index=False)
            if len(rows) % 50 == 0:
                print(
                    f"{len(rows)} of {asked.number} cases, {time.time() - started:.0f} s", file=sys.stderr, flush=True
                )
    table = pd.DataFrame(rows)
    for message in table["failed"].dropna():
        print("failed:", message)
    whole = table[table["failed"].isna()]
    print(kind.tell(whole) if len(whole) else "no case went through")


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
    write_case(folder, case, np.random.default_rng(seed))
    study = load_study(folder)
    return study, run(study, folder / "run").results


def hidden_names(case: Case) -> Row:
    """Name what is hidden."""
    return {"hidden": " + ".join(f"{h.cause}:{h.joint}" for h in case.hidden)}
