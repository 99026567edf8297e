"""The gain: what an extension is worth on rows that no fit has seen, with an interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.estimation.accuracy import distances
from calflow.measurements.columns import blocks_of
from calflow.measurements.measurements import Measurements

RESAMPLES = 2000
INTERVAL = (0.025, 0.975)


@dataclass(frozen=True)
class Gain:
    """By how much the mean position error falls [m], and its 95 % interval; nan where nothing is held out."""

    mean: float
    low: float
    high: float


def gain(before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator) -> Gain:
    """Compare two models' errors (n_rows, 3) [m] on held-out rows, resampling whole poses (within payload and session)."""
    if not len(heldout):
        return Gain(np.nan, np.nan, np.nan)
    fallen = distances(before) - distances(after)
    blocks = blocks_of(heldout.table)
    table = heldout.table[["pose", *blocks]].assign(fallen=fallen)
    poses = table.groupby("pose", sort=True).agg(
        total=("fallen", "sum"), n=("fallen", "size"), **{name: (name, "first") for name in blocks}
    )
    total, count = np.zeros(RESAMPLES), np.zeros(RESAMPLES)
    for _, group in poses.groupby(blocks, sort=True):
        drawn = rng.integers(len(group), size=(RESAMPLES, len(group)))
        total += group["total"].to_numpy()[drawn].sum(axis=1)
        count += group["n"].to_numpy()[drawn].sum(axis=1)
    low, high = np.quantile(total / count, INTERVAL)
    return Gain(float(fallen.mean()), float(low), float(high))
