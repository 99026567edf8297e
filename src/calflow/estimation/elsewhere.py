"""Elsewhere: what a model errs by at poses that it was not fitted to, by leaving out each training pose in turn.

Where a model lacks something, its parameters make up for it at the poses that they were fitted to, and most at those that hang on
few others. What is left there tells too little of other poses; errors of poses that were left out tell it (Stone 1974). They
come from one Jacobian, without a refit (Allen's PRESS 1974): with H a pose's share in its own prediction they are
(I - H)⁻¹ times the residual, and (I - H)⁻¹ is their covariance, over the noise, where the model lacks nothing.

Extrapolation: joints whose held-out readings lie beyond what was fitted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from calflow.estimation.fit import Fit
from calflow.estimation.fit_summary import Extrapolation
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

BY_CHANCE = 0.05  # chance of errors as large where nothing is lacking, above which they show no excess


@dataclass(frozen=True)
class LeftOut:
    """Errors of poses left out in turn, over the noise: the sum of their squares, what was to be expected, and their number.

    share is the median of what is expected of one, scatter the noise per axis [m], freedom the degrees of freedom left to the fit.
    """

    found: float
    expected: float
    number: int
    share: float
    scatter: float
    freedom: float

    @property
    def rms(self) -> float:
        """Root mean square of the errors of positions, noise in it [m]; nan without any."""
        return float(np.sqrt(3 * self.found / self.number)) * self.scatter if self.number else float("nan")

    def excess(self, level: np.ndarray | float = 1.0) -> np.ndarray:
        """Return by how much more than expected the model errs, sd per axis [m], were squares by a level larger; at least 0."""
        if not self.number:
            return np.zeros(np.shape(level))
        more = np.maximum(level * np.float64(self.found / self.expected) - 1.0, 0.0) * self.share
        return np.asarray(np.sqrt(more)) * self.scatter

    def drawn(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw so many values of the excess as the errors, by their degrees of freedom, allow (number,) [m].

        Errors that are no larger than chance makes them now and then show none: what may be there besides is not in them.
        """
        if not self.number or chi2.sf(self.freedom * self.found / self.expected, self.freedom) > BY_CHANCE:
            return np.zeros(number)
        return self.excess(self.freedom / rng.chisquare(self.freedom, number))


def left_out(fit: Fit, pose: np.ndarray) -> LeftOut:
    """Return the errors of poses left out in turn of a fitted model.

    Args:
        fit: the model as it was fitted; lengths alone are taken into account.
        pose: the number of each row's pose, (n_rows,): rows of one pose are left out together.
    """
    squares, covered, sizes = np.concatenate([*_by_pose(fit, pose), np.zeros((3, 0))], axis=1)
    number = int(sizes.sum())
    share = float(np.median(covered / sizes)) if number else 0.0
    freedom = max(1.0, number - fit.effective_parameters)
    # Added pose by pose, so that where parts end does not show in the last digit.
    return LeftOut(float(sum(squares)), float(sum(covered)), number, share, fit.problem.scatter, freedom)


def elsewhere(fit: Fit, pose: np.ndarray) -> float:
    """Return by how much more a fitted model errs at poses left out than noise and parameters say, sd per axis [m]; at least 0.

    Args: as of `left_out`.
    """
    return float(left_out(fit, pose).excess())


def _by_pose(fit: Fit, pose: np.ndarray) -> Iterator[np.ndarray]:
    """Yield for poses, of as many lengths, what each errs by when left out, what is expected, and how many lengths; (3, n_poses).

    Errors are squared, and over the noise.
    """
    for block in fit.problem.reweighted(fit.estimate, fit.loss).blocks:
        lengths = np.array([unit == METRE for unit in block.observation.units])
        if not lengths.any():
            continue
        block = block.together(pose[block.rows])
        for rows, _, residual, jacobian in block.independent(fit.estimate, pose[block.rows]):
            _, first, count = np.unique(pose[rows], return_index=True, return_counts=True)
            for many in np.unique(count):
                own = first[count == many, None] + np.arange(many)
                yield _left_out(residual[own][..., lengths], jacobian[own][:, :, lengths], fit.covariance)


def _left_out(residual: np.ndarray, jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The same of poses with as many rows: residuals (n_poses, n_rows, n_lengths) and their Jacobian."""
    n_poses = len(residual)
    residual = residual.reshape(n_poses, -1)
    jacobian = jacobian.reshape(*residual.shape, len(covariance))
    size = residual.shape[1]
    covered = np.linalg.inv(np.eye(size) - jacobian @ covariance @ jacobian.transpose(0, 2, 1))
    missed = (covered @ residual[:, :, None])[:, :, 0]
    return np.array([np.vecdot(missed, missed), np.trace(covered, axis1=1, axis2=2), np.full(n_poses, float(size))])


BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted ones


def extrapolation(data: Measurements) -> tuple[Extrapolation, ...]:
    """Return the joints whose held-out readings lie beyond what was fitted: their accuracy is a guess, good or bad."""
    train, heldout = data.joints[data.train], data.joints[data.held_out]
    if not len(heldout):
        return ()
    low, high = train.min(axis=0), train.max(axis=0)
    margin = BEYOND * np.maximum(high - low, np.ptp(data.joints[data.train | data.held_out], axis=0))
    beyond = (heldout < low - margin) | (heldout > high + margin)
    return tuple(
        Extrapolation(joint=int(i) + 1, rows=int(beyond[:, i].sum())) for i in np.flatnonzero(beyond.any(axis=0))
    )


def beyond(readings: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return which joint readings (n_rows, n_joints) lie outside those measured (n_measured, n_joints) by a tenth of the range."""
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low)
    return np.asarray((readings < low - margin) | (readings > high + margin))
