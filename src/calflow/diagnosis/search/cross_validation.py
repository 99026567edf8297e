"""Cross-validation inside the training rows: whether a cause carries over to poses that were not fitted.

Blocks of poses that are near each other, in joint space or in time, are left out in turn, and predicted by what the others
tell (Roberts et al. 2017): a cause that stands for something else fits the rows that it was found on, and no others. Linear, from
one Jacobian, without a refit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from calflow.diagnosis.screening.regressors import Regressors
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause

LEVELS = 3  # of halving: eight blocks of each kind
FEWEST = 2  # poses of a block
WORSE = 0.01  # one-sided significance at which a cause makes blocks that were left out worse


@dataclass(frozen=True)
class CarriedOver:
    """What a cause gains at blocks of training poses that were left out: in chi², and by the largest error.

    gain is the sum over blocks, per kind of block; largest the mean logarithm of each block's largest error without the cause over
    that with it, and p the chance that it is so much below zero by accident.
    """

    gain: tuple[float, ...]
    largest: float
    p: float

    @property
    def holds(self) -> bool:
        """Whether it does carry over."""
        return max(self.gain) > 0 and self.p > WORSE


def blocks(fitted: Fitted) -> list[np.ndarray]:
    """Number the training rows by blocks of poses, near in joint space, and where the order is known in time; (n_rows,) each."""
    data = fitted.data
    first, number = np.unique(fitted.poses, return_index=True, return_inverse=True)[1:]
    angles = data.joints[first]
    levels = min(LEVELS, int(np.log2(max(len(first) // FEWEST, 1))))
    found = [_halved(angles / np.maximum(angles.std(axis=0), 1e-9), levels)[number]]
    if "order" in data.given:
        rank = np.argsort(np.argsort(data.table["order"].to_numpy(float)[first]))
        found.append((rank * 2**levels // len(first))[number])
    return found


def _halved(places: np.ndarray, levels: int) -> np.ndarray:
    """Number places (n, n_axes) by the leaves of a k-d tree (Bentley 1975): each block is halved where it is longest."""
    block = np.zeros(len(places), dtype=int)
    for _ in range(levels):
        upper = np.zeros(len(places), dtype=bool)
        for one in np.unique(block):
            own = np.flatnonzero(block == one)
            along = places[own, int(np.argmax(np.ptp(places[own], axis=0)))]
            upper[own[np.argsort(along, kind="stable")[len(own) // 2 :]]] = True
        block = 2 * block + upper
    return block


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The blocks of one kind, each to be predicted by what the others tell of a linearised model.

    rows are the numbers of each block's residuals, fitted (n_blocks, n_free, n_free) the products of the Jacobian with itself
    over these, left (n_blocks, n_free) those with the residual: what the others tell is the sum of theirs.
    """

    regressors: Regressors[Cause]
    rows: tuple[np.ndarray, ...]
    fitted: np.ndarray
    left: np.ndarray

    @staticmethod
    def of(regressors: Regressors[Cause], block: np.ndarray) -> LeftOut:
        """Add up the products block by block, by which the residuals are numbered (n,)."""
        rows = tuple(np.flatnonzero(block == one) for one in np.unique(block))
        parts = [(regressors.jacobian[own], regressors.residual[own]) for own in rows]
        return LeftOut(regressors, rows, np.array([j.T @ j for j, _ in parts]), np.array([j.T @ e for j, e in parts]))

    @cached_property
    def missed(self) -> list[np.ndarray]:
        """Each block's whitened errors, the parameters fitted to the others."""
        return self.missed_without(np.zeros(0, dtype=int), np.zeros(0))

    def missed_without(self, gone: np.ndarray, value: np.ndarray) -> list[np.ndarray]:
        """Return the same without some of the free parameters (their numbers), which have these values."""
        known = self.regressors
        keep = np.setdiff1d(np.arange(self.fitted.shape[1]), gone)
        change, prior = np.zeros(self.fitted.shape[1]), np.diag(known.precision[keep])
        change[gone] = value
        found = []
        for k, own in enumerate(self.rows):
            others = np.arange(len(self.rows)) != k
            whole = self.fitted[others].sum(axis=0)
            left = self.left[others].sum(axis=0) - whole[:, gone] @ value
            change[keep] = np.linalg.solve(whole[np.ix_(keep, keep)] + prior, left[keep] + known.pull[keep])
            found.append(known.residual[own] - known.jacobian[own] @ change)
        return found


def left_out(fitted: Fitted) -> list[LeftOut]:
    """Return a fitted model's blocks, a kind at a time."""
    row = fitted.problem.stacking.row
    return [LeftOut.of(fitted.alone, kind[row]) for kind in blocks(fitted)]


def carried_over(fitted: Fitted, cause: Cause, kinds: Sequence[LeftOut]) -> CarriedOver:
    """Predict each block of each kind from the others, with a cause of the model and without it."""
    free = np.flatnonzero(~fitted.fit.at_bound)
    own = np.flatnonzero(np.isin(free, fitted.model.columns(cause)))
    value = fitted.fit.estimate[free][own]
    gains, ratios = [], list[float]()
    for kind in kinds:
        pairs = list(zip(kind.missed_without(own, value), kind.missed, strict=True))
        gains.append(float(sum(a @ a - b @ b for a, b in pairs)))
        ratios += [np.log(np.abs(a).max() / np.abs(b).max()) for a, b in pairs]
    mean, spread = float(np.mean(ratios)), float(np.std(ratios, ddof=1)) / np.sqrt(len(ratios))
    p = float(student.cdf(mean / spread, len(ratios) - 1)) if spread > 0 else 1.0
    return CarriedOver(tuple(gains), mean, p)
