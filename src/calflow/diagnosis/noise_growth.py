"""Noise growth: a test for noise of the measuring device that grows with range."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import MOST_LEVERAGE, Fitted
from calflow.estimation.noise import MIN_REPEATS, Noise
from calflow.files.deferred import pd
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

RANGE = "range"  # the condition of a row with which noise may grow
STILL = 0.02  # p-value required of the growth of residuals without their smooth part
ROWS_A_REGRESSOR = 4  # rows required for each smooth function that is removed
WIDE = 10.0  # search range of a log standard deviation about its starting value


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
        """Return the growth scaled to the residuals of a model fitted with it, whose smooth part is an error too."""
        level = float(np.median(fitted.noise.sigma / fitted.outlier_factor / self.sigma(fitted.data, fitted.device)))
        return replace(self, floor=level * self.floor, slope=level * self.slope, sd=level * self.sd)


@dataclass(frozen=True)
class SpreadByRange:
    """Squared scatter (n,) [m²] of single measurements, its degrees of freedom (n,), and ranges, distance (n,) [m].

    stated (n,) [m] is the assumed noise of the device there, setup (n,) the number of the device and session.
    """

    squared: np.ndarray
    freedom: np.ndarray
    stated: np.ndarray
    distance: np.ndarray
    setup: np.ndarray


def growth_of_repeats(fitted: Fitted, significance: float) -> Growth | None:
    """Return the growth with range of the scatter of repeats, which is free of model errors; None where not significant."""
    spread = _of_repeats(fitted)
    if spread is None or not (p := _rank_test(spread)) < significance:
        return None
    return _fitted(spread, p)


def growth_of_residuals(fitted: Fitted) -> Growth | None:
    """Return the growth with range of the residuals of a model with its causes; None with repeats, or without ranges.

    It must be significant in, and is fitted to, residuals without their smooth part in joint readings and place, which is a misfit
    that the noise must not absorb.
    """
    if RANGE not in fitted.data.given or _of_repeats(fitted):
        return None
    error, rows = _left(fitted)
    left = _by_range(fitted, error, rows)
    if not len(rows):
        return None
    error = _without_what_is_smooth(error, fitted.data.joints[rows], fitted.data.position[rows])
    rough = _by_range(fitted, error, rows)
    return _fitted(rough, _rank_test(left) if _rank_test(rough) < STILL else 1.0)


def _rank_test(spread: SpreadByRange) -> float:
    """Return the p-value of growth by rank correlation (Spearman 1904), which is valid for any tails of the noise.

    Only growth within a set-up counts: of two devices the further one may be the noisier.
    """
    beyond = spread.squared / spread.freedom / spread.stated**2
    ranks = pd.DataFrame({"beyond": beyond, "distance": spread.distance}).rank()
    within = ranks - ranks.groupby(spread.setup).transform("mean")
    freedom = len(ranks) - 1 - len(np.unique(spread.setup))
    if freedom < 1 or not within.any().all():
        return 1.0
    correlation = within["beyond"].corr(within["distance"])
    return float(scipy.stats.t.sf(correlation * np.sqrt(freedom / max(1 - correlation**2, 1e-300)), freedom))


def _of_repeats(fitted: Fitted) -> SpreadByRange | None:
    """Return the scatter of repeats with a range; None where its degrees of freedom are too few."""
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
        scatter.squared,
        scatter.freedom,
        (noise.sigma * np.sqrt(data.repeats))[usable],
        distance[usable],
        _setups(data)[usable],
    )


def _left(fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Return the studentised residuals of positions observed from outside, times the noise (n, 3) [m], and their rows (n,)."""
    # Other rows have no range, or a stated noise that grows with it.
    positions = [observed.units[:3] == (METRE,) * 3 and observed.from_outside and not observed.series.beam
                 for observed in fitted.model.observations]  # fmt: skip
    rows = np.flatnonzero(np.array(positions)[fitted.data.series_number])
    size = fitted.noise.total * np.sqrt(fitted.data.repeats)
    return fitted.studentised[rows, :3] * size[rows, None], rows


def _by_range(fitted: Fitted, error: np.ndarray, rows: np.ndarray) -> SpreadByRange:
    """Return the errors (n, 3) [m] of rows (n,) as a spread."""
    stated = (fitted.device.sigma * np.sqrt(fitted.data.repeats))[rows]
    distance = fitted.data.table[RANGE].to_numpy()[rows]
    return SpreadByRange((error**2).sum(axis=1), np.full(len(rows), 3.0), stated, distance, _setups(fitted.data)[rows])


def _setups(data: Measurements) -> np.ndarray:
    """Return the number (n_rows,) of each row's device and session."""
    session = data.table["session"].astype(str) if "session" in data.table else ""
    table = data.table[[]].assign(series=data.series_number, session=session)
    return np.asarray(table.groupby(["series", "session"]).ngroup())


def _without_what_is_smooth(error: np.ndarray, joints: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return errors (n_rows, 3) less their regression on harmonics of joint readings and a quadratic in place (n_rows, 3)."""
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
    """Return the maximum-likelihood floor and slope, by their logarithms."""
    middle = float(np.sqrt(np.median(spread.squared / spread.freedom)))
    start = np.log([middle / 2, middle / 2 / np.mean(spread.distance)])
    x = ca.MX.sym("x", 2)
    variance = (ca.exp(x[0]) + ca.exp(x[1]) * ca.DM(spread.distance)) ** 2
    cost = ca.sum1(0.5 * ca.DM(spread.squared) / variance + 0.5 * ca.DM(spread.freedom) * ca.log(variance))
    curvature, slope = ca.hessian(cost, x)
    function = ca.Function("cost", [x], [cost, slope, curvature])
    optimum = scipy.optimize.minimize(
        lambda at: float(function(at)[0]), start, jac=lambda at: np.array(function(at)[1]).ravel(), method="L-BFGS-B",
        bounds=np.stack([start - WIDE, start + WIDE], axis=1),
    ).x  # fmt: skip
    inverse = np.linalg.pinv(np.array(function(optimum)[2]), hermitian=True)
    sd = float(np.sqrt(max(inverse[1, 1], 0.0)) * np.exp(optimum[1]))
    return Growth(float(np.exp(optimum[0])), float(np.exp(optimum[1])), sd, p)
