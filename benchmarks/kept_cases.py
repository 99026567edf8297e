"""What benchmarks of many cases share: a case a row of a CSV, so that a run goes on after a kill and runs of several seeds add up.

--cases N      how many cases there are to be (30)
--seed S       of all draws (1): case k of seed S is the same whatever N and P are
--processes P  in so many processes (1)
--out FILE     the table of cases; what it has already is not run again, and the figures are of all that it has
--keep FOLDER  where each case's files are kept, where it has files
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

Row = dict[str, object]


@dataclass(frozen=True)
class Place:
    """Which case it is, and where its files are kept if they are to be."""

    kind: str
    number: int
    seed: int
    keep: Path | None

    @property
    def rng(self) -> np.random.Generator:
        """The case's own draws."""
        return np.random.default_rng([self.seed, self.number, *self.kind.encode()])

    @property
    def folder(self) -> Path | None:
        """The case's own folder."""
        return self.keep / f"{self.kind}-{self.seed}-{self.number:04d}" if self.keep else None


Work = Callable[[Place], list[Row]]
Kinds = Mapping[str, tuple[Work, Callable[[pd.DataFrame], str]]]


def run_cases(description: str | None, kinds: Kinds) -> None:
    """Run the cases that the command line asks for, and print what their table tells."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=list(kinds), nargs="?" if len(kinds) == 1 else None, default=next(iter(kinds)))
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    work, tell = kinds[asked.kind]
    table = pd.read_csv(asked.out) if asked.out and asked.out.exists() else pd.DataFrame()
    done = set(zip(table["kind"], table["seed"], table["case"], strict=True)) if len(table) else set()
    places = [Place(asked.kind, k, asked.seed, asked.keep) for k in range(asked.cases)]
    places = [place for place in places if (place.kind, place.seed, place.number) not in done]
    for rows in _worked(partial(guarded, work), places, asked.processes):
        table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
        if asked.out:
            part = asked.out.with_suffix(".part")
            table.to_csv(part, index=False)
            part.replace(asked.out)
    mine = table[table["kind"] == asked.kind]
    for _, row in mine[mine["failed"].notna()].iterrows():
        print(f"failed: seed {row['seed']}, case {row['case']}: {row['failed']}")
    whole = mine[mine["failed"].isna()]
    print(tell(whole) if len(whole) else "no case went through")
    if len(whole):
        cases = whole.drop_duplicates(["seed", "case"])
        print(
            f"\n{len(cases)} cases, {cases['cpu_s'].sum():.0f} s of the processor, median {cases['cpu_s'].median():.1f} s"
        )


def _worked(work: Work, places: list[Place], processes: int) -> Iterator[list[Row]]:
    if processes == 1:
        yield from map(work, places)
        return
    with ProcessPoolExecutor(processes) as pool:
        for job in as_completed([pool.submit(work, place) for place in places]):
            yield job.result()


def guarded(work: Work, place: Place) -> list[Row]:
    """Work on a case; where that fails its row says how."""
    started = time.process_time()
    known: Row = {"kind": place.kind, "seed": place.seed, "case": place.number, "failed": None}
    try:
        rows = work(place)
    except Exception as error:  # one bad case must not end the others
        rows = [{"failed": f"{type(error).__name__}: {error}"}]
    spent = time.process_time() - started
    print(
        f"{place.kind} {place.seed} {place.number}: {spent:.1f} s {rows[0].get('failed') or ''}",
        file=sys.stderr,
        flush=True,
    )
    return [known | row | {"cpu_s": spent} for row in rows]


def calibration_table(stated: pd.Series, right: pd.Series, bins: list[float]) -> str:
    """Stated probabilities against shares right, by bins of what was stated."""
    told = pd.DataFrame({"stated": stated.astype(float), "right": right.astype(float)})
    groups = told.groupby(pd.cut(told["stated"], bins, include_lowest=True), observed=False)
    table = groups.agg(n=("right", "size"), stated=("stated", "mean"), right=("right", "mean"))
    return f"{table.round(3).to_string()}\nall {len(told)}: stated {told['stated'].mean():.3f}, right {told['right'].mean():.3f}"
