"""Noise growth: whether a measuring device scatters more the further it looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import spearmanr

from calflow.diagnosis.search.fitted import Fitted

MOST_LEVERAGE = 0.95


@dataclass(frozen=True)
class Growth:
    """Noise of floor + slope · range: floor [m], slope [m/m] with its standard deviation, and the p-value of slope > 0."""

    floor: float
    slope: float
    sd: float
    p: float

    def sigma(self, distance: np.ndarray) -> np.ndarray:
        """Return the standard deviation per axis [m] of one measurement at these ranges [m]."""
        return self.floor + self.slope * distance


def growth(fitted: Fitted, level: float) -> Growth | None:
    """Test whether what a fitted model leaves grows with range, by ranks, and fit the growth where it does.

    Ranks (Spearman 1904) keep their promise whatever the noise's tails are; residuals are freed of their leverage first.
    """
    if "range" not in fitted.data.given:
        return None
    distance = fitted.data.table["range"].to_numpy()
    residual, weight = fitted.fit.residual[:, :3], 1 / fitted.noise.total[0]
    kept = 1 - np.concatenate([
        np.einsum("rai,ij,raj->ra", jacobian, fitted.fit.covariance, jacobian, optimize=True)
        for _, jacobian in fitted.problem.linearised(fitted.fit.estimate)
    ])[:, :3]  # fmt: skip
    error = residual / np.sqrt(np.maximum(kept, 1 - MOST_LEVERAGE))
    size = np.linalg.norm(error, axis=1)
    p = float(spearmanr(size, distance, alternative="greater").pvalue)
    if not p < level:
        return None
    metres = error / weight[:, None] * np.sqrt(fitted.data.repeats)[:, None]
    return _fitted(metres, distance, p)


def _fitted(error: np.ndarray, distance: np.ndarray, p: float) -> Growth:
    """Maximum likelihood of floor and slope, in logarithms; error is that of single measurements."""
    squared = (error**2).sum(axis=1)
    middle = float(np.sqrt(np.median(squared) / 2.366))  # the median of chi² with 3 degrees of freedom

    def cost(x: np.ndarray) -> float:
        variance = (np.exp(x[0]) + np.exp(x[1]) * distance) ** 2
        return float((0.5 * squared / variance + 1.5 * np.log(variance)).sum())

    start = np.log([middle / 2, middle / 2 / np.mean(distance)])
    found = minimize(cost, start, method="BFGS")
    sd = float(np.sqrt(max(found.hess_inv[1, 1], 0.0)) * np.exp(found.x[1]))
    return Growth(float(np.exp(found.x[0])), float(np.exp(found.x[1])), sd, p)
