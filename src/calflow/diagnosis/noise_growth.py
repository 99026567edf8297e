"""Noise growth: whether a measuring device scatters more the further it looks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.estimation.noise import MIN_REPEATS, Noise
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

RANGE = "range"  # the condition of a row that noise is tested to grow with
MOST_LEVERAGE = 0.95
STILL = 0.02  # p-value that the growth of what is not smooth must have
ROWS_A_REGRESSOR = 4  # rows that there must be for every smooth function that is taken off


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

    def levelled(self, fitted: Fitted) -> Growth:
        """Return the same growth at the level that a model fitted with it leaves: what is smooth there is no less an error."""
        level = float(np.median(fitted.noise.sigma / fitted.far / self.sigma(fitted.data, fitted.device)))
        return replace(self, floor=level * self.floor, slope=level * self.slope, sd=level * self.sd)


@dataclass(frozen=True)
class SpreadByRange:
    """Squared scatter (n,) [m²] of single measurements, its degrees of freedom, and the ranges [m] that it was seen at.

    stated [m] is the noise that the device is taken to have there.
    """

    squared: np.ndarray
    freedom: np.ndarray
    stated: np.ndarray
    distance: np.ndarray


def growth_of_repeats(fitted: Fitted, significance: float) -> Growth | None:
    """Test whether the scatter of repeats grows with range, and fit the growth where it does; no model's error is in that."""
    spread = _of_repeats(fitted)
    if spread is None or not (p := _rank_test(spread)) < significance:
        return None
    return _fitted(spread, p)


def growth_of_residuals(fitted: Fitted, significance: float) -> Growth | None:
    """Test the same of what a model with its causes leaves, where there are no repeats to tell.

    It must show, and be as large, in what is left without all that is smooth in the joints' readings and in place too: that is
    a misfit, which the noise must not swallow.
    """
    if RANGE not in fitted.data.given or _of_repeats(fitted):
        return None
    left = _of_residuals(fitted)
    if not len(left.squared) or not _rank_test(left) < significance:
        return None
    rough = _of_residuals(fitted, smooth=False)
    return _fitted(rough, _rank_test(left)) if _rank_test(rough) < STILL else None


def _rank_test(spread: SpreadByRange) -> float:
    """The chance of so much growth by ranks (Spearman 1904), which keep their promise whatever the noise's tails are."""
    beyond = spread.squared / spread.freedom / spread.stated**2
    return float(scipy.stats.spearmanr(beyond, spread.distance, alternative="greater").pvalue)


def _of_repeats(fitted: Fitted) -> SpreadByRange | None:
    """The scatter of repeats that have a range; None where it is too little."""
    noise, data = fitted.device, fitted.data
    if noise.scatter is None or RANGE not in data.given:
        return None
    distance = data.table[RANGE].to_numpy()
    usable = (noise.scatter.freedom > 0) & ~noise.scatter.gross & np.isfinite(distance)
    for k, series in enumerate(data.series):
        usable &= ~data.of_series(k) | (series.beam is None)
    scatter = noise.scatter.only(usable)
    if scatter.freedom.sum() < MIN_REPEATS:
        return None
    return SpreadByRange(
        scatter.squared, scatter.freedom, (noise.sigma * np.sqrt(data.repeats))[usable], distance[usable]
    )


def _of_residuals(fitted: Fitted, smooth: bool = True) -> SpreadByRange:
    """What the model leaves of positions seen from outside, freed of leverage; with what is smooth in it, or without."""
    error, rows = [np.zeros((0, 3))], [np.zeros(0, dtype=int)]
    for block in fitted.problem.blocks:
        observation = block.observation
        if observation.units[:3] != (METRE,) * 3 or not observation.from_outside or observation.series.beam:
            continue  # no range, or one whose noise is stated already
        for here, residual, jacobian in block.linearised(fitted.fit.estimate):
            predicted = np.einsum("rai,ij,raj->ra", jacobian, fitted.fit.covariance, jacobian, optimize=True)[:, :3]
            error.append(residual[:, :3] / np.sqrt(np.maximum(1 - predicted, 1 - MOST_LEVERAGE)))
            rows.append(here)
    row = np.concatenate(rows)
    metres = np.concatenate(error) * (fitted.noise.total * np.sqrt(fitted.data.repeats))[row, None]
    if not smooth and len(row):
        metres = _without_what_is_smooth(metres, fitted.data.joints[row], fitted.data.position[row])
    stated = (fitted.device.sigma * np.sqrt(fitted.data.repeats))[row]
    return SpreadByRange(
        (metres**2).sum(axis=1), np.full(len(row), 3.0), stated, fitted.data.table[RANGE].to_numpy()[row]
    )


def _without_what_is_smooth(error: np.ndarray, joints: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return errors (n_rows, 3) without their regression on waves of the joints' readings and squares of place (n_rows, 3)."""
    place = place - place.mean(axis=0)
    waves = [wave(order * q) for order in (1, 2) for q in joints.T for wave in (np.cos, np.sin)]
    products = [place[:, i] * place[:, j] for i in range(3) for j in range(i, 3)]
    smooth = [*place.T, *waves[: 2 * joints.shape[1]], *products, *waves[2 * joints.shape[1] :]]
    regressors = np.stack([np.ones(len(error)), *smooth[: len(error) // ROWS_A_REGRESSOR]], axis=1)
    basis, triangle = np.linalg.qr(regressors)
    basis = basis[:, np.abs(np.diag(triangle)) > 1e-9 * np.abs(triangle).max()]
    leverage = (basis**2).sum(axis=1)
    return np.asarray(
        (error - basis @ (basis.T @ error)) / np.sqrt(np.maximum(1 - leverage, 1 - MOST_LEVERAGE))[:, None]
    )


def _fitted(spread: SpreadByRange, p: float) -> Growth:
    """Maximum likelihood of floor and slope, in logarithms."""
    middle = float(np.sqrt(np.median(spread.squared / spread.freedom)))
    x = ca.SX.sym("x", 2)
    variance = (ca.exp(x[0]) + ca.exp(x[1]) * ca.DM(spread.distance)) ** 2
    cost = ca.sum1(0.5 * ca.DM(spread.squared) / variance + 0.5 * ca.DM(spread.freedom) * ca.log(variance))
    curvature, slope = ca.hessian(cost, x)
    function = ca.Function("likelihood", [x], [cost, slope, curvature])
    start = np.log([middle / 2, middle / 2 / np.mean(spread.distance)])
    optimum = scipy.optimize.minimize(
        lambda at: float(function(at)[0]), start, jac=lambda at: np.array(function(at)[1]).ravel(), method="BFGS"
    ).x
    inverse = np.linalg.pinv(np.array(function(optimum)[2]), hermitian=True)
    sd = float(np.sqrt(max(inverse[1, 1], 0.0)) * np.exp(optimum[1]))
    return Growth(float(np.exp(optimum[0])), float(np.exp(optimum[1])), sd, p)
