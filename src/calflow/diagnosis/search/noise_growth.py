"""Noise growth: whether a measuring device scatters more the further it looks."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import minimize
from scipy.stats import spearmanr

from calflow.diagnosis.search.fitted import Fitted
from calflow.estimation.noise import Noise
from calflow.measurements.measurements import Measurements

RANGE = "range"  # the condition of a row that noise is tested to grow with
MOST_LEVERAGE = 0.95


@dataclass(frozen=True)
class Growth:
    """Noise of floor + slope · range: floor [m], slope [m/m] with its standard deviation, and the p-value of slope > 0."""

    floor: float
    slope: float
    sd: float
    p: float

    def sigma(self, data: Measurements, device: Noise) -> np.ndarray:
        """Return each row's standard deviation per axis [m]; rows without a range keep the device's."""
        if "range" not in data.given:
            return device.sigma
        distance = data.table["range"].to_numpy()
        grown = (self.floor + self.slope * distance) / np.sqrt(data.repeats)
        return np.where(np.isfinite(distance), grown, device.sigma)


def growth(fitted: Fitted, significance: float) -> Growth | None:
    """Test whether what a fitted model leaves grows with range, by ranks, and fit the growth where it does.

    Ranks (Spearman 1904) keep their promise whatever the noise's tails are; residuals are freed of their leverage first.
    """
    if RANGE not in fitted.data.given:
        return None
    found = [(np.zeros((0, 3)), np.zeros(0, dtype=int))]
    for block in fitted.problem.blocks:
        if (
            block.observation.units[:3] != ("m",) * 3
            or not block.observation.from_outside
            or block.observation.series.beam
        ):
            continue  # no range, or one whose noise is stated already
        for rows, residual, jacobian in block.linearised(fitted.fit.estimate):
            predicted = np.einsum("rai,ij,raj->ra", jacobian, fitted.fit.covariance, jacobian, optimize=True)[:, :3]
            found.append((residual[:, :3] / np.sqrt(np.maximum(1 - predicted, 1 - MOST_LEVERAGE)), rows))
    error, rows = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if not len(rows):
        return None
    distance = fitted.data.table[RANGE].to_numpy()[rows]
    size = np.linalg.norm(error, axis=1)
    p = float(spearmanr(size, distance, alternative="greater").pvalue)
    if not p < significance:
        return None
    metres = error * (fitted.noise.total * np.sqrt(fitted.data.repeats))[rows, None]
    return _fitted(metres, distance, p)


def _fitted(error: np.ndarray, distance: np.ndarray, p: float) -> Growth:
    """Maximum likelihood of floor and slope, in logarithms; error is that of single measurements."""
    squared = (error**2).sum(axis=1)
    middle = float(np.sqrt(np.median(squared) / 2.366))  # the median of chi² with 3 degrees of freedom
    x = ca.SX.sym("x", 2)
    variance = (ca.exp(x[0]) + ca.exp(x[1]) * ca.DM(distance)) ** 2
    cost = ca.sum1(0.5 * ca.DM(squared) / variance + 1.5 * ca.log(variance))
    curvature, slope = ca.hessian(cost, x)
    function = ca.Function("likelihood", [x], [cost, slope, curvature])
    start = np.log([middle / 2, middle / 2 / np.mean(distance)])
    found = minimize(
        lambda at: float(function(at)[0]), start, jac=lambda at: np.array(function(at)[1]).ravel(), method="BFGS"
    ).x
    spread = np.linalg.pinv(np.array(function(found)[2]), hermitian=True)
    sd = float(np.sqrt(max(spread[1, 1], 0.0)) * np.exp(found[1]))
    return Growth(float(np.exp(found[0])), float(np.exp(found[1])), sd, p)
