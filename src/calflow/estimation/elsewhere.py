"""Elsewhere: what a model errs by at poses that it was not fitted to, by leaving out each training pose in turn.

Where a model lacks something, its parameters make up for it at the poses that they were fitted to, and most at those that hang on
few others. What is left there tells too little of other poses; errors of poses that were left out tell it (Stone 1974). They
come from one Jacobian, without a refit (Allen's PRESS 1974): with H a pose's share in its own prediction they are
(I - H)⁻¹ times the residual, and (I - H)⁻¹ is their covariance, over the noise, where the model lacks nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from calflow.estimation.fit import Fit

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
        fit: the model as it was fitted; orientations are left out of account.
        pose: the number of each row's pose, (n_rows,): rows of one pose are left out together.
    """
    found, expected, number, shares = 0.0, 0.0, 0, list[float]()
    for residual, jacobian in _by_pose(fit, pose):
        covered = np.linalg.inv(np.eye(len(residual)) - jacobian @ fit.covariance @ jacobian.T)
        missed = covered @ residual
        found, expected = found + float(missed @ missed), expected + float(np.trace(covered))
        number += len(residual)
        shares.append(np.trace(covered) / len(residual))
    share = float(np.median(shares)) if shares else 0.0
    freedom = max(1.0, number - fit.effective_parameters)
    return LeftOut(found, expected, number, share, fit.problem.scatter, freedom)


def elsewhere(fit: Fit, pose: np.ndarray) -> float:
    """Return by how much more a fitted model errs at poses left out than noise and parameters say, sd per axis [m]; at least 0.

    Args: as of `left_out`.
    """
    return float(left_out(fit, pose).excess())


def _by_pose(fit: Fit, pose: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield each pose's whitened residuals (n,), of lengths, and their Jacobian (n, n_parameters)."""
    for block in fit.problem.reweighted(fit.estimate, fit.loss).blocks:
        lengths = np.array([unit != "rad" for unit in block.observation.units])
        for rows, *part in block.linearised(fit.estimate):
            residual, jacobian = block.independent(*part)
            order = np.argsort(pose[rows], kind="stable")
            ends = np.flatnonzero(np.diff(pose[rows][order])) + 1
            for own in np.split(order, ends):
                yield residual[own][:, lengths].ravel(), jacobian[own][:, lengths].reshape(-1, jacobian.shape[2])
