"""Block cross-validation of causes (Roberts et al. 2017).

Blocks of neighbouring training poses, in joint space or in time, are left out in turn and predicted from the others: a cause that
stands for something else fits only the rows on which it was found. Linear, from one Jacobian, without a refit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calflow.diagnosis.background import BackgroundBasis, background
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.linear_model import LinearModel
from calflow.effects.cause import Cause
from calflow.estimation.leverage import halved

HALVINGS = 3  # which make eight blocks of each kind
FEWEST_POSES = 2  # poses of a block
WORSE = 0.01  # one-sided significance at which a cause increases the errors of left-out blocks
LEAST_TOLD = 1e-8  # share of a direction's information that the other blocks have: less is rounding


@dataclass(frozen=True)
class CarriedOver:
    """The gain of a cause at left-out blocks of training poses.

    gain: reduction of chi², summed over the blocks of each kind; p: one-sided p-value that the largest errors of blocks grow with
    the cause, by the mean of the log ratios of those without it to those with it.
    """

    gain: tuple[float, ...]
    p: float

    @property
    def holds(self) -> bool:
        return max(self.gain) > 0 and self.p > WORSE


def pose_blocks(fitted: Fitted) -> list[np.ndarray]:
    """Return the residuals' blocks of poses, near in joint space and, if the order is known, in time; (n,) each."""
    data = fitted.data
    first, number = np.unique(fitted.poses, return_index=True, return_inverse=True)[1:]
    levels = min(HALVINGS, int(np.log2(max(len(first) // FEWEST_POSES, 1))))
    angles = data.joints[first]
    kinds = [halved(angles / np.maximum(angles.std(axis=0), 1e-9), levels)[number]]
    if "order" in data.given:
        rank = np.argsort(np.argsort(data.table["order"].to_numpy(float)[first]))
        kinds.append((rank * 2**levels // len(first))[number])
    return [kind[fitted.problem.row] for kind in kinds]


@dataclass(frozen=True, eq=False)
class LeftOutBlock:
    """A block of residuals (n_own,), predicted by a model fitted to the others; it follows from the fit to all.

    Parameters are in coordinates in which the information of all residuals and priors is one. root R (n_free, n_own): of the
    predictions' covariance RᵀR by the fit to all; residual (n_own,): by that fit; factor: Cholesky factor of I - RᵀR, or of I - RRᵀ
    where that is smaller, the information of the other blocks and the priors.
    """

    root: np.ndarray
    residual: np.ndarray
    factor: tuple[np.ndarray, bool]

    @staticmethod
    def each(model: LinearModel[Cause], block: np.ndarray) -> list[LeftOutBlock]:
        blocks = []
        for rows in (np.flatnonzero(block == number) for number in np.unique(block)):
            root = model.prediction_root[:, rows]
            told = root @ root.T if len(root) < len(rows) else root.T @ root
            factor = scipy.linalg.cho_factor((1 + LEAST_TOLD) * np.eye(len(told)) - told, lower=True)
            blocks.append(LeftOutBlock(root, model.settled_residual[rows], factor))
        return blocks

    def predicted(self, values: np.ndarray) -> np.ndarray:
        """Return (I - RᵀR)⁻¹ times values (n_own, …): errors of the fit to all as errors of predictions (Woodbury 1950)."""
        if len(self.factor[0]) == len(values):
            return np.asarray(scipy.linalg.cho_solve(self.factor, values))
        return np.asarray(values + self.root.T @ scipy.linalg.cho_solve(self.factor, self.root @ values))

    @cached_property
    def error(self) -> np.ndarray:
        return self.predicted(self.residual)

    def without(self, along: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Return the errors (n_own,) without parameters of a value (n,) by the fit to all, given a root of their covariance."""
        moved = self.root.T @ along
        told, estimate = self.predicted(moved), value + moved.T @ self.error
        return self.error - told @ np.linalg.solve(along.T @ along + moved.T @ told, estimate)


def carried_over(
    fitted: Fitted, cause: Cause, beside: LinearModel[Cause], kinds: Sequence[Sequence[LeftOutBlock]]
) -> CarriedOver:
    """Return the gain of a cause of the model, linearised with its background, at left-out blocks of each kind.

    A general smooth function of time cannot predict times that were left out: it is tested on blocks in joint space alone.
    """
    gains, ratios = [], list[float]()
    parameters, estimate = fitted.own(cause)
    along, value = beside.root_covariance(parameters), estimate + beside.change[parameters]
    for blocks in kinds[:1] if cause.effect.smooth_in else kinds:
        pairs = [(block.without(along, value), block.error) for block in blocks]
        gains.append(float(sum(a @ a - b @ b for a, b in pairs)))
        ratios += [np.log(np.abs(a).max() / np.abs(b).max()) for a, b in pairs]
    mean, spread = float(np.mean(ratios)), float(np.std(ratios, ddof=1)) / np.sqrt(len(ratios))
    p = float(scipy.stats.t.cdf(mean / spread, len(ratios) - 1)) if spread > 0 else 1.0
    return CarriedOver(tuple(gains), p)


def carrying(fitted: Fitted, basis: BackgroundBasis, causes: Iterable[Cause]) -> Iterator[bool]:
    beside = LinearModel(fitted.alone.beside(background(fitted, basis), fitted.problem.weight))
    kinds = [LeftOutBlock.each(beside, kind) for kind in pose_blocks(fitted)]
    yield from (carried_over(fitted, cause, beside, kinds).holds for cause in causes)
