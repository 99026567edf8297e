"""The size of an angle error curve: its root mean square over the measured travel, and that to be expected elsewhere.

A smooth curve is estimated as zero between readings, so that its own root mean square depends on how densely the travel was
measured. Its size is that of its posterior as a Gaussian process instead, averaged over the scale of its prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
import scipy

from calflow.effects.base import Cause, Travel
from calflow.estimation.variance_components import SIZES

CANDIDATE_SIZES = np.geomspace(SIZES.min(), SIZES.max(), 65)  # over the usual one
MIN_REDUCTION = 1e-12  # least relative reduction of a variance by the data


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve's amplitudes, their covariance (n, n) and prior standard deviation (n,), and the prior root mean square of curves."""

    estimate: np.ndarray
    covariance: np.ndarray
    usual: np.ndarray
    usual_rms: float
    travel: Travel

    @classmethod
    def of(cls, cause: Cause, estimate: np.ndarray, covariance: np.ndarray) -> Self | None:
        """Return a cause's curve; None without one."""
        travel = cause.effect.travel(cause.joint) if cause.joint else None
        if travel is None:
            return None
        usual = np.array([parameter.prior_sd for parameter in cause.declared])
        return cls(estimate, covariance, usual, float(ca.evalf(cause.effect.size(ca.SX(usual)))), travel)

    @cached_property
    def weight(self) -> np.ndarray:
        """Posterior probability of each of CANDIDATE_SIZES, (n_sizes,).

        The sum of squares of the shrunken estimates is approximately a scaled chi-squared variable (Satterthwaite 1946); the prior
        of sizes is that of causes.
        """
        usual, variance = self.usual**2, np.diag(self.covariance)
        told = np.maximum(usual - variance, MIN_REDUCTION * usual)
        expected = told / usual * (CANDIDATE_SIZES[:, None] ** 2 * told + variance)
        whole = expected.sum(axis=1)
        freedom = whole**2 / (expected**2).sum(axis=1)
        logs = scipy.stats.chi2.logpdf(self.estimate @ self.estimate * freedom / whole, freedom)
        logs += np.log(freedom / whole) - np.log(np.maximum(CANDIDATE_SIZES, 1.0))
        weight = np.exp(logs - logs.max())
        return np.asarray(weight / weight.sum())

    @property
    def rms_elsewhere(self) -> float:
        """Root mean square of another curve of the same kind."""
        return self.usual_rms * float(np.sqrt(self.weight @ CANDIDATE_SIZES**2))

    @property
    def rms_over_travel(self) -> tuple[float, float]:
        """Root mean square over the travel, between readings included, and its standard deviation."""
        scale, identity = np.outer(self.usual, self.usual), np.eye(len(self.usual))
        # Information of the data along its principal axes.
        known, axes = np.linalg.eigh(np.linalg.inv(self.covariance / scale + MIN_REDUCTION * identity) - identity)
        known = np.maximum(known, MIN_REDUCTION)
        products = axes.T @ (self.travel.products * scale) @ axes
        variance = 1 / (known + CANDIDATE_SIZES[:, None] ** -2.0)
        mean = variance * (known + 1) * (axes.T @ (self.estimate / self.usual))
        # Mean and variance of a quadratic form of normal amplitudes (Searle 1971).
        along = mean @ products
        square = (along * mean).sum(axis=1) + variance @ np.diag(products)
        spread = 4 * (along**2 * variance).sum(axis=1) + 2 * (variance @ products**2 * variance).sum(axis=1)
        average = float(self.weight @ square)
        return average**0.5, float(self.weight @ (spread + (square - average) ** 2) / average) ** 0.5 / 2
