"""Blind cases with a background that the catalogue lacks: what the diagnosis says where no model is complete.

    python benchmarks/incomplete.py causes 120    one cause at 2, 3 or 5 detection limits, and a background
    python benchmarks/incomplete.py alone 60      a background, and no cause
    python benchmarks/incomplete.py loud 12       the same at five times the noise

Backgrounds (tests/hidden/backgrounds.py): smooth errors of two joints that depend on other joints too, a hose that drags, a
device that wanders, and errors that the markers of a pose share. Their size is the rms displacement of the tool per axis over
the noise; "left" is the same of what the identified model cannot imitate. Limits are those of the case without background.
--out FILE.csv keeps the single cases: a row a case, what it says of several findings with ";" between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count, islice, product
from pathlib import Path

import blind_cases as cases
import blind_verdicts as verdicts
import held_out
import incomplete_tables as tables
import numpy as np
import pandas as pd
from blind_cases import Job
from blind_run import Kind, Row, guarded, hidden_names, run_case, run_kind
from imitated import left_over

from calflow.files.tables import Results
from calflow.study import Study
from hidden.backgrounds import KINDS as BACKGROUNDS
from hidden.backgrounds import Background, crossed_joints, displaced
from hidden.case import Case, draw

SIZES = (0.3, 0.5, 1.0)  # of a background, over the noise
LIMITS = (2.0, 3.0, 5.0)  # of a cause
LOUD = 5.0  # as SIZES
JOINTS = 6


def causes(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """One cause, and a background; each kind and size of both equally often."""
    for kind, size, limits in _in_turn(number, rng, list(BACKGROUNDS), SIZES, LIMITS):
        yield Job(_with_background(kind, size, rng), cases.new_seed(rng), kind, limits, 1)


def alone(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """A background of each kind and size equally often, and no cause."""
    for kind, size in _in_turn(number, rng, list(BACKGROUNDS), SIZES):
        yield Job(_with_background(kind, size, rng), cases.new_seed(rng), kind)


def loud(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """A background that nobody should miss, and no cause."""
    for (kind,) in _in_turn(number, rng, list(BACKGROUNDS)):
        yield Job(_with_background(kind, LOUD, rng), cases.new_seed(rng), kind)


def _in_turn(number: int, rng: np.random.Generator, *choices: Sequence) -> Iterator[tuple]:
    """Return number combinations, all of them in a random order before any comes again."""
    every = list(product(*choices))
    rounds = (every[i] for _ in count() for i in rng.permutation(len(every)))
    return islice(rounds, number)


def _with_background(kind: str, size: float, rng: np.random.Generator) -> Case:
    case = cases.design(rng)
    return replace(case, background=Background(kind, size * case.sigma, cases.new_seed(rng)))


def compared(job: Job) -> Row:
    """Hide what the job says, and compare each finding with it."""

    def work(folder: Path) -> Row:
        case = cases.sized(job, folder / "bare").case if job.several else job.case
        folder = folder / "case"
        study, results = run_case(folder, case, job.seed)
        rows = [row for _, row in verdicts.named_causes(results).iterrows()]
        offs = [off for h in case.hidden for row in rows for off in verdicts.off_by(h, row).values()]
        known = hidden_names(case) | background(case, job.seed, study, results) | verdicts.told(results)
        known |= {"lack_of_fit_p": results.documents["diagnose/summary.json"]["lack_of_fit_p"]}
        known |= each_finding(case, rows) | {"z": offs[0] if offs else None}
        return known | held_out.errors(results) | held_out.covered(folder / "run", folder / "measurements.csv", results)

    return guarded(work, job)


def background(case: Case, seed: int, study: Study, results: Results) -> Row:
    """State the background's size, and what the identified model cannot imitate of it, per axis over the noise."""
    assert case.background
    world = draw(case, np.random.default_rng(seed))
    left = left_over(study, results, displaced(case.background, world.real, world.rows))
    return {
        "background": case.background.kind,
        "background_size": case.background.size / case.sigma,
        "left": float(np.sqrt(np.mean(left**2))) / case.sigma,
    }


def each_finding(case: Case, rows: Sequence[pd.Series]) -> Row:
    """Say of each finding whether it is the hidden cause, and how surely it was named."""
    told = {
        "status": [row["status"] for row in rows],
        "probability": [row["probability"] for row in rows],
        "exactly": [any(verdicts.is_exactly(h, row) for h in case.hidden) for row in rows],
        "in_set": [any(verdicts.holds(h, row) for h in case.hidden) for row in rows],
        "up_to_class": [any(verdicts.is_alike(h, row) for h in case.hidden) for row in rows],
        "is_background": [names_background(case, row) for row in rows],
    }
    return {f"each_{name}": ";".join(map(str, values)) for name, values in told.items()}


def names_background(case: Case, row: pd.Series) -> bool:
    """Whether a finding is a part of the background, rightly named: an error of a joint that errs with its own angle, a drift."""
    assert case.background
    if case.background.kind == "joints":
        crossed = crossed_joints(case.background, JOINTS)
        erring = {one.driven + 1 for one in crossed if one.driven in one.inputs}
        return bool(row["cause"] in verdicts.FAMILY and row["joint"] in erring)
    return bool(case.background.kind == "drift" and row["cause"] == "frame-drift")


KINDS = {
    "causes": Kind(causes, compared, tables.with_causes),
    "alone": Kind(alone, compared, tables.alone),
    "loud": Kind(loud, compared, tables.alone),
}


if __name__ == "__main__":
    run_kind(__doc__, KINDS)
