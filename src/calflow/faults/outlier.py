"""Outlier: a row that is grossly off, and nobody knows why."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.stats import t

from calflow.faults.base import Check, Correction, Fault, fault
from calflow.faults.reference import Reference, Rough, changed
from calflow.measurements.measurements import Measurements

# Nothing but its size speaks for an outlier, so noise with heavy tails must not look like one: the limit is what the
# largest of so many rows exceeds once in 300 data sets if each axis has Student's t with 3 degrees of freedom, measured by
# the 90 % quantile of the rows that are not gross (4.1 for the length of three such t's). At 120 rows that is 38 standard
# deviations of normal noise. Of many such rows, or of such that go together, the model lacks the cause.
DEGREES, TAIL_QUANTILE, TAIL_LENGTH = 3, 0.9, 4.0972
FALSE = 1 / 300  # data sets without a fault in which one is found
MOST = 0.15  # of the rows: more are no outliers
GROUP = 0.5  # of a payload's or marker's rows: more are a payload or marker of another kind
RUN, SAME_WAY = 4, 0.7  # poses in a row that err this much the same way: a step or a drift
SMALL = 1e-4  # rad or m: a step of a joint
ALONG, SHARE = 0.9, 0.8  # cosine to the way a joint moves the tool, of this share of the rows: something in that joint


class Outlier(Check):
    """Leave out the rows that are far beyond what the noise of the others would ever show."""

    id: ClassVar[str] = "outlier"
    title: ClassVar[str] = "a row is grossly off"
    order: ClassVar[int] = 90

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault with all outliers."""
        fit = reference.fit
        error = data.position - fit.predicted(data.rows)
        miss, used = reference.miss, data.train | data.held_out
        limit = limit_of(miss[used], fit.scale, fit.gross)
        off = used & (miss > limit)
        off &= ~together(data, error, off)
        if not 0 < off.sum() <= MOST * used.sum() or _of_a_joint(data, fit, error, np.flatnonzero(off)):
            return ()
        rows = np.flatnonzero(off)
        far = np.linalg.norm(error[off], axis=1)
        least, most = 1e3 * far.min(), 1e3 * far.max()
        size = f"{most:.3g} mm" if len(rows) == 1 else f"{least:.3g} to {most:.3g} mm"
        statement = (
            f"the position in LINES is {size} from where all other rows say it is, which miss by "
            f"{1e3 * float(np.median(miss[used])):.2g} mm; left out, measure again or correct the file"
        )
        return (fault(self, data, 0, [Correction(int(row) + 1) for row in rows], "left out", statement),)


def limit_of(miss: np.ndarray, scale: float, gross: float) -> float:
    """Return the error [m] beyond which a row is an outlier, for the errors (n_rows,) of all rows.

    scale [m] is their robust standard deviation per axis, gross [m] what is gross.
    """
    usual = np.quantile(miss[miss < gross], TAIL_QUANTILE) if (miss < gross).any() else scale
    largest = t.isf(FALSE / (6 * len(miss)), DEGREES)  # of three axes, to both sides
    return max(gross, float(usual / TAIL_LENGTH * largest))


def together(data: Measurements, error: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Return the rows that are off together with others: of one payload or marker, or in a row and the same way."""
    groups = np.zeros(len(off), dtype=bool)
    for label in ("payload", "marker"):
        share = data.table.assign(off=off).groupby(label)["off"].transform("mean").to_numpy()
        groups |= share > GROUP
    pose = data.table["pose"].to_numpy()
    begins = np.flatnonzero(np.r_[True, off[1:] != off[:-1]])
    for run in np.split(np.arange(len(off)), begins[1:]):
        if off[run[0]] and len(set(pose[run])) >= RUN:
            way = error[run] / np.linalg.norm(error[run], axis=1, keepdims=True)
            groups[run] |= np.linalg.norm(way.mean(axis=0)) > SAME_WAY
    return groups


def _of_a_joint(data: Measurements, fit: Rough, error: np.ndarray, rows: np.ndarray) -> bool:
    """Whether nearly all these rows err in the direction in which one and the same joint moves the tool."""
    if len(data.table["pose"].iloc[rows].unique()) < RUN:
        return False
    here, wrong = fit.predicted(data.rows[:, rows]), error[rows] / np.linalg.norm(error[rows], axis=1, keepdims=True)
    for joint in range(data.robot.n_joints):
        moved = fit.predicted(changed(data, joint, data.joints[rows, joint] + SMALL, rows)) - here
        along = np.abs((moved * wrong).sum(axis=1)) > ALONG * np.linalg.norm(moved, axis=1)
        if along.mean() >= SHARE:
            return True
    return False
