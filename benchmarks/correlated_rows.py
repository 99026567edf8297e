"""Errors that hang together from row to row, and nothing else: what is named, without a robot and with one.

    python benchmarks/correlated_rows.py linear --cases 120
    python benchmarks/correlated_rows.py robot --cases 60

Without a robot a cubic course is fitted to readings in time, and switching, waves, steps and decays may be found; with one, arms of
foreign_physics.py are identified and diagnosed. Errors are AR(1) of 0.5 to 0.95 from row to row, a random walk beside white noise,
or shared by the 50 readings of each of 30 poses; white ones stand beside them. Their standard deviation is stated in half of the
cases; who reads without a robot says which rows share an error in half of the cases in which they do. A name is false
whatever it is, but that a device wanders: errors that shift what is reported, alike in neighbouring rows, are that.
steady is where the device is said to step, or to go one way.
"""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from foreign_physics import ARMS, Array, measured_rows, points, worn
from foreign_study import identified, names_of, write_study
from kept_cases import Place, Row
from scipy.signal import lfilter

from calflow.linear import Block, diagnose_linear

POSES, REPEATS = 30, 50
WALK = 0.7  # of the errors' variance, what a random walk has of it at its end
SHARED = 0.6  # of the errors' variance, what the readings of a pose share
ERRORS = ("white", "AR(1) 0.5", "AR(1) 0.8", "AR(1) 0.95", "random walk", "shared by poses")
DEVICE = {"frame-drift", "frame-step", "session-frame"}


def errors(kind: str, number: int, group: Array, rng: np.random.Generator) -> Array:
    """Errors (number, 3) of standard deviation 1; group (number,) says which rows are of one pose."""
    white = rng.standard_normal((number, 3))
    if kind.startswith("AR(1)"):
        rho = float(kind.split()[1])
        white[1:] *= np.sqrt(1 - rho**2)
        return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0))
    if kind == "random walk":
        walk = np.cumsum(rng.standard_normal((number, 3)), axis=0) / np.sqrt(number)
        return np.sqrt(1 - WALK) * white + np.sqrt(WALK) * walk
    if kind == "shared by poses":
        return np.sqrt(1 - SHARED) * white + np.sqrt(SHARED) * rng.standard_normal((group.max() + 1, 3))[group]
    return white


def work_linear(place: Place) -> list[Row]:
    """Readings in time of a course and such errors, diagnosed without a robot."""
    kind, stated = list(product(ERRORS, (True, False)))[place.number % (2 * len(ERRORS))]
    rng, shared = place.rng, kind == "shared by poses"
    number = POSES * REPEATS if shared else int(np.exp(rng.uniform(*np.log([100, 1500]))))
    group = np.arange(number) // REPEATS
    said = shared and rng.random() < 0.5
    time = np.linspace(0, 10, number)
    course = np.vander(time / 10, 4)
    residual = course @ rng.normal(size=4) * 5 - errors(kind, number, group, rng)[:, 0]
    told = diagnose_linear(
        residual, course, _candidates(time), rng=rng, noise=1.0 if stated else None, groups=group if said else None
    )
    return [_row(kind + (", said so" if said else ""), stated, number, [finding.name for finding in told.findings])]


def _candidates(time: Array) -> list[Block]:
    blocks = [Block("switching", np.where(time % period < duty * period, 1.0, 0.0)[:, None], 3.0, f"{period}, {duty}")
              for period, duty in product((1.7, 2.5), (0.3, 0.5))]  # fmt: skip
    blocks += [
        Block("wave", np.column_stack([np.cos(w * time), np.sin(w * time)]), 3.0, f"{w:.2f}")
        for w in np.linspace(1, 20, 25)
    ]
    blocks += [
        Block("step", (time > moment).astype(float)[:, None], 3.0, f"{moment:.1f}")
        for moment in np.arange(0.5, 10, 0.5)
    ]
    blocks += [Block("decay", np.exp(-time / constant)[:, None], 3.0, f"{constant}") for constant in (0.3, 1.0, 3.0)]
    return blocks


def work_robot(place: Place) -> list[Row]:
    """An arm measured with such errors, identified and diagnosed."""
    kind, stated = list(product(ERRORS, (True, False)))[place.number % (2 * len(ERRORS))]
    rng, shared = place.rng, kind == "shared by poses"
    arm = ARMS[list(ARMS)[place.number // len(ERRORS) % len(ARMS)]]
    rows = measured_rows(arm, POSES if shared else 120, rng, payloads=(2,) if shared else (0, 1, 2))
    if shared:
        rows = rows.only(np.repeat(np.arange(POSES), REPEATS))
    sigma = float(rng.uniform(2e-5, 4e-5))
    seen = points(worn(arm, rng), rows) + sigma * errors(kind, len(rows), rows.pose, rng)
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, arm, rows, seen, sigma=sigma if stated else None, columns=("approach", "time"))
        names = names_of(identified(folder).diagnose())
    steady = names["cause"].isin(DEVICE) & ~names["detail"].fillna("").str.startswith("wandering")
    row = _row(kind, stated, len(rows), list(names["cause"]), list(names["probability"]))
    return [row | {"steady": bool(steady.any()), "arm": arm.name}]


def _row(kind: str, stated: bool, number: int, names: list[str], probability: list[float] = []) -> Row:  # noqa: B006
    return {"errors": kind, "stated": stated, "rows": number, "named": bool(names), "others": bool(set(names) - DEVICE),
            "number": len(names), "names": ";".join(names), "probability": ";".join(map(str, probability))}  # fmt: skip


def tell(rows: pd.DataFrame) -> str:
    """How often anything is named, and anything but a device that moves, by kind of errors."""
    rows = rows.assign(correlated=np.where(rows["errors"] == "white", "white", "correlated"))
    shares = [name for name in ("named", "steady", "others", "number") if name in rows]
    shown = {"n": ("named", "size")} | {name: (name, "mean") for name in shares}
    tables = [rows.groupby(keys).agg(**shown).round(3).to_string() for keys in (["correlated"], ["errors", "stated"])]
    return "\n\n".join(tables)


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"linear": (work_linear, tell), "robot": (work_robot, tell)})
