"""The noise model: tests for noise of the device that grows with range, or that is larger in some set-ups than in others.

A set-up is one device in one session, or one marker that it sees. The test is a regression of the cube roots of squared errors,
which are nearly normal for normal noise (Wilson and Hilferty 1931), and of finite variance for heavy tails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.estimation.calibrated_model import SeriesNoise
from calflow.estimation.lack_of_fit import WORTH_TELLING, NoiseDoubt, doubt
from calflow.estimation.noise import MIN_REPEATS, Label, Noise, Scatter, group_means
from calflow.files.deferred import pd
from calflow.files.units import METRE
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements

RANGE = "range"  # the condition of a row with which noise may grow
UNLIKELY = 0.02  # p-value of equal noise above which that of set-ups is not settled
ROWS_A_REGRESSOR = 4  # rows required for each smooth function that is removed
WIDE = 10.0  # search range of a log standard deviation about its starting value
MOST_LEVERAGE = 0.95  # of smooth functions on a residual, by which it is studentised
COMPARABLE = 0.5  # least share of a set-up's indicator that its poses do not predict
PASSES = 3  # refits in which the noise of set-ups settles
ROUNDING = 1e-9  # singular value of regressors over the largest, below which it is rounding


@dataclass(frozen=True)
class Growth:
    """Noise of floor + slope · range: floor [m], slope [m/m] with its standard deviation, and the p-value of slope > 0."""

    floor: float
    slope: float
    sd: float
    p: float

    @property
    def words(self) -> str:
        return f"the noise grows with range: {rounded(1e6 * self.slope)} µm/m"

    def sigma(self, data: Measurements, device: Noise) -> np.ndarray:
        """Return each row's standard deviation per axis [m]; rows without a range keep the device's."""
        if RANGE not in data.given:
            return device.sigma
        distance = data.table[RANGE].to_numpy()
        grown = (self.floor + self.slope * distance) / np.sqrt(data.repeats)
        return np.where(np.isfinite(distance), grown, device.sigma)

    def devices(self, devices: Sequence[SeriesNoise], data: Measurements) -> tuple[SeriesNoise, ...]:
        """Return the noise of each series with the growth, where its rows have a range."""
        ranged = np.isfinite(data.table[RANGE].to_numpy())
        return tuple(
            replace(each, sigma=self.floor, growth=self.slope) if ranged[data.of_series(k)].all() else each
            for k, each in enumerate(devices)
        )

    def levelled(self, fitted: Fitted) -> Growth:
        """Return the growth scaled to the residuals of a model fitted with it, whose smooth part is an error too."""
        level = float(np.median(fitted.noise.sigma / fitted.outlier_factor / self.sigma(fitted.data, fitted.device)))
        return replace(self, floor=level * self.floor, slope=level * self.slope, sd=level * self.sd)


@dataclass(frozen=True, eq=False)
class SetUps:
    """What rows may have a noise of their own: those of each series that bear one label.

    label: the column that holds it; number (n_rows,): of each row's set-up; within (n_rows,): of the rows that are compared.
    """

    label: Label
    number: np.ndarray
    within: np.ndarray

    @property
    def compared(self) -> bool:
        seen = np.unique(np.stack([self.within, self.number]), axis=1)
        return seen.shape[1] > len(np.unique(self.within))

    @staticmethod
    def every(data: Measurements) -> tuple[SetUps, SetUps]:
        """Return each device in each session, all of which are compared, and its markers, which are compared within these.

        Of two markers, each seen in a session of its own, one may be the noisier by the session.
        """
        table = pd.DataFrame({label: data.labels(label) for label in ("session", "marker")}).assign(
            series=data.series_number
        )
        session, marker = (table.groupby(["series", label]).ngroup().to_numpy() for label in ("session", "marker"))
        return SetUps("session", session, np.zeros(len(data), dtype=int)), SetUps("marker", marker, session)


@dataclass(frozen=True)
class NoiseLevels:
    """Noise that is larger in some set-ups: factors of each series' noise by what a label names, and the p-value of equal noise."""

    label: Label
    factors: tuple[Mapping[str, float], ...]
    p: float
    shown_by: Literal["repeats", "residuals"] = "residuals"

    @property
    def words(self) -> str:
        """The largest factor in words, over the least: that is one where the noise is stated."""
        every = [factor for each in self.factors for factor in each.values()]
        largest = max(every) / min(1.0, *every)
        between = {"session": "devices or sessions", "marker": "markers"}[self.label]
        return f"the noise differs between {between}: up to {rounded(largest)} times the quietest one's"

    def factor(self, data: Measurements) -> np.ndarray:
        """Return each row's factor (n_rows,)."""
        of_row = zip(data.series_number, data.labels(self.label), strict=True)
        return np.array([self.factors[series].get(name, 1.0) for series, name in of_row])

    def sigma(self, data: Measurements, device: Noise) -> np.ndarray:
        """Return each row's standard deviation per axis [leading unit]."""
        return device.sigma * self.factor(data)

    def devices(self, devices: Sequence[SeriesNoise], data: Measurements) -> tuple[SeriesNoise, ...]:
        """Return the noise of each series with these factors."""
        factor = self.factor(data) ** 2
        return tuple(
            replace(
                each,
                label=self.label,
                factors=self.factors[k],
                typical=each.typical * float(np.sqrt(factor[data.of_series(k)].mean())),
            )
            for k, each in enumerate(devices)
        )

    def levelled(self, _: Fitted) -> NoiseLevels:
        """Return the factors themselves: they are those of a model fitted with them."""
        return self

    def doubts(self, data: Measurements, stated: Noise) -> Iterator[NoiseDoubt]:
        """Yield a doubt of each noise of single rows as stated that is too small in a set-up."""
        for k, series in enumerate(data.series):
            if stated.sources[k] != "file":
                continue
            for name, factor in self.factors[k].items():
                rows = data.of_series(k) & (data.labels(self.label) == name)
                if factor > 1:
                    level = float(np.sqrt(np.mean(stated.sigma[rows] ** 2)))
                    yield doubt(stated.leading[k], level, factor, series=series.name, shown_by=self.shown_by, believed=False,
                                p=self.p, **{self.label: name})  # fmt: skip


Kind = TypeVar("Kind", Growth, NoiseLevels)


@dataclass(frozen=True, eq=False)
class ErrorSizes(Scatter):
    """Sizes of errors: squares with degrees of freedom, the noise taken to be theirs (n,) [unit], and their rows (n,)."""

    noise: np.ndarray
    rows: np.ndarray

    @property
    def root(self) -> np.ndarray:
        """Cube roots (n,) of the squares over the noise's variance, 1 on average for normal noise."""
        return np.asarray(np.cbrt(self.squared / self.noise**2 / 2) / scipy.special.poch(self.freedom / 2, 1 / 3))

    def regression(self, tested: np.ndarray, beside: np.ndarray) -> tuple[float, float]:
        """Return the p-value of the roots' regression on tested (n, k) beside others (n, m), and its last coefficient."""
        weight = np.sqrt(self.freedom)
        every, root = np.column_stack([beside, tested]) * weight[:, None], weight * self.root
        fewer, more = (scipy.linalg.orth(some, ROUNDING) for some in (every[:, : beside.shape[1]], every))
        before, after = (float(root @ root - ((basis.T @ root) ** 2).sum()) for basis in (fewer, more))
        spent, left = more.shape[1] - fewer.shape[1], len(root) - more.shape[1]
        if spent < 1 or left < 1 or not after > 0:
            return 1.0, 0.0
        p = scipy.special.fdtrc(spent, left, (before - after) / spent * left / after)
        return float(p), float(np.linalg.lstsq(every, root, rcond=None)[0][-1])


def noise_of_repeats(fitted: Fitted) -> Growth | NoiseLevels | None:
    """Return how the scatter of repeats, which is free of model errors, differs from the assumed noise; None without repeats."""
    repeats = _of_repeats(fitted)
    if repeats is None:
        return None
    constant = np.ones((len(repeats.rows), 1))
    levels = _likelier(*(_levels(fitted, repeats, each, constant) for each in SetUps.every(fitted.data)))
    return _likelier(_growth(fitted.data, repeats), levels and replace(levels, shown_by="repeats"))


def noise_of_residuals(fitted: Fitted) -> Growth | NoiseLevels | None:
    """Return how a model's residuals differ from the assumed noise, without their smooth part, a misfit; None with repeats."""
    if _of_repeats(fitted):
        return None
    # Other rows have no range, or a stated noise that grows with it.
    looking = np.array([observed.units[:3] == (METRE,) * 3 and observed.from_outside and not observed.series.beam
                        for observed in fitted.model.observations])  # fmt: skip
    rough = _of_residuals(fitted, SetUps.every(fitted.data)[0])
    positions = rough.only(looking[fitted.data.series_number[rough.rows]])
    return _likelier(_growth(fitted.data, positions), levels_of_residuals(fitted))


def _likelier(one: Kind | None, other: NoiseLevels | None) -> Kind | NoiseLevels | None:
    if one and other:
        p = min(1.0, 2 * min(one.p, other.p))
        return replace(one, p=p) if one.p < other.p else replace(other, p=p)
    return one or other


def levels_of_residuals(fitted: Fitted) -> NoiseLevels | None:
    """Return the noise of sessions or markers by the residuals of a model fitted with it, without their smooth part."""
    return _likelier(*(_settled(fitted, each) for each in SetUps.every(fitted.data)))


def _settled(fitted: Fitted, setups: SetUps) -> NoiseLevels | None:
    """Return the noise of set-ups by residuals of a model that is fitted with it.

    Set-ups are compared beside smooth functions of joint readings and place: where they measured different poses, the larger errors
    of one may be the model's.
    """
    found, seen = None, fitted
    for _ in range(PASSES if setups.compared else 0):
        rough = _of_residuals(seen, setups)
        now = _levels(fitted, rough, setups, _smooth_functions(fitted, rough.rows))
        if now is None:
            break
        found = replace(now, p=found.p if found else now.p)
        if found.p > UNLIKELY:
            break
        seen = fitted.weighed(found.sigma(fitted.data, fitted.device))
    return found


def _growth(data: Measurements, sizes: ErrorSizes) -> Growth | None:
    """Return the growth of sizes with range within set-ups, as of two devices the further may be noisier; None without ranges."""
    if RANGE not in data.given:
        return None
    sizes = sizes.only(np.isfinite(data.table[RANGE].to_numpy()[sizes.rows]))
    if not len(sizes.rows):
        return None
    distance = data.table[RANGE].to_numpy()[sizes.rows]
    both_ways, slope = sizes.regression(distance[:, None], _indicators(SetUps.every(data)[0].number[sizes.rows]))
    return _fitted(sizes, distance, both_ways / 2 if slope > 0 else 1 - both_ways / 2)


def _levels(fitted: Fitted, sizes: ErrorSizes, setups: SetUps, beside: np.ndarray) -> NoiseLevels | None:
    """Return the noise of set-ups by the sizes of errors beside regressors (n, k); None where none is noisier than others.

    A set-up that measured other poses than the others is not compared. Of a stated noise a factor is at least 1, and what the
    quietest set-up leaves beyond it is no set-up's noise.
    """
    data, device, rows = fitted.data, fitted.device, sizes.rows
    beside = np.column_stack([beside, _indicators(setups.within[rows])])
    series = data.series_number[rows]
    table = pd.DataFrame({
        "unit": [device.leading[k].label for k in series], "known": [device.sources[k] == "file" for k in series],
        "series": series, "name": data.labels(setups.label)[rows], "root": sizes.root * sizes.freedom, "freedom": sizes.freedom,
        "assumed": sizes.noise**2, "stated": (device.sigma**2 * data.repeats)[rows], "setup": setups.number[rows],
    })  # fmt: skip
    table = table[_not_predicted(_indicators(table["setup"].to_numpy()), beside) > COMPARABLE]
    table = table[table.groupby("unit")["setup"].transform("nunique") > 1]
    if not len(table):
        return None
    units = pd.get_dummies(table["unit"], dtype=float)
    sizes, beside = sizes.only(table.index.to_numpy()), np.column_stack([beside[table.index], units])
    p, _ = sizes.regression(_indicators(table["setup"].to_numpy()), beside)
    found = table.groupby(["unit", "known", "series", "name"]).agg(
        {"root": "sum", "freedom": "sum", "assumed": "median", "stated": "mean"}
    )
    shown = (found["root"] / found["freedom"]) ** 3 * found["assumed"]
    misfit = (shown - found["stated"]).groupby(["unit", "known"]).transform("min").clip(lower=0.0)
    known = found.index.get_level_values("known").to_numpy(bool)
    factor = ((shown - misfit * known) / found["stated"]) ** 0.5
    factor = factor.where(~known | (factor > WORTH_TELLING), 1.0)
    if factor.max() <= WORTH_TELLING * factor.min():
        return None
    factors: list[dict[str, float]] = [{} for _ in data.series]
    for (_, _, k, name), times in factor[factor != 1.0].items():
        factors[k][name] = times
    return NoiseLevels(setups.label, tuple(factors), p)


def _not_predicted(setups: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Return the share (n,) of the indicator of each row's set-up that regressors (n, k) do not predict, 1 if by chance alone."""
    basis, apart = scipy.linalg.orth(beside, ROUNDING), setups - setups.mean(axis=0)
    left = apart - basis @ (basis.T @ apart)
    share = (left**2).sum(axis=0) / np.maximum((apart**2).sum(axis=0), 1e-300)
    return np.asarray(setups @ share * (len(setups) - 1) / max(1, len(setups) - basis.shape[1]))


def _of_repeats(fitted: Fitted) -> ErrorSizes | None:
    """Return the scatter of repeats in sessions beside the assumed noise; None where its degrees of freedom are too few."""
    noise, data = fitted.device, fitted.data
    if noise.scatter is None:
        return None
    beams = np.array([series.beam is not None for series in data.series])
    usable = (noise.scatter.freedom > 0) & ~beams[data.series_number]
    scatter, rows = noise.scatter.only(usable), np.flatnonzero(usable)
    if scatter.freedom.sum() < MIN_REPEATS:
        return None
    return ErrorSizes(scatter.squared, scatter.freedom, (noise.sigma * np.sqrt(data.repeats))[rows], rows)


def _of_residuals(fitted: Fitted, setups: SetUps) -> ErrorSizes:
    """Return poses' studentised residuals in leading units without their smooth part, beside noise and misfit.

    The smooth part is their regression on harmonics of joint readings and a quadratic in place, series by series. Rows of a pose
    share errors, so that together, in a set-up, they are one size.
    """
    data, noise, setup = fitted.data, fitted.noise.total, setups.number
    squared, freedom = np.zeros(len(data)), np.zeros(len(data))
    for k, observed in enumerate(fitted.model.observations):
        rows = np.flatnonzero(data.of_series(k))
        leading = [unit == observed.units[0] for unit in observed.units]
        error = fitted.studentised[rows, : len(leading)][:, leading]
        basis = scipy.linalg.orth(_smooth_functions(fitted, rows) / noise[rows, None], ROUNDING)
        left = np.maximum(1 - (basis**2).sum(axis=1), 1 - MOST_LEVERAGE)
        squared[rows] = ((error - basis @ (basis.T @ error)) ** 2).sum(axis=1) / left
        freedom[rows] = error.shape[1]
    of_pose = fitted.poses * (setup.max() + 1) + setup
    _, first, group = np.unique(of_pose, return_index=True, return_inverse=True)
    single = (noise * np.sqrt(data.repeats))[first]
    return ErrorSizes(np.bincount(group, squared) * single**2, np.bincount(group, freedom), single, first)


def _indicators(number: np.ndarray) -> np.ndarray:
    return np.asarray(np.unique(number) == number[:, None], dtype=float)


def _smooth_functions(fitted: Fitted, rows: np.ndarray) -> np.ndarray:
    """Return smooth functions (n, k) of joint readings and a pose's place at rows, the constant first, as many as these permit."""
    joints, of_rows = fitted.data.joints[rows], fitted.model.point(fitted.fit.estimate, fitted.data.conditions)
    pose = np.unique(fitted.poses, return_inverse=True)[1]
    place = group_means(of_rows, pose)[pose][rows]
    place = place - place.mean(axis=0)
    waves = [wave(order * q) for order in (1, 2) for q in joints.T for wave in (np.cos, np.sin)]
    products = [place[:, i] * place[:, j] for i in range(3) for j in range(i, 3)]
    smooth = [*place.T, *waves[: 2 * joints.shape[1]], *products, *waves[2 * joints.shape[1] :]]
    return np.stack([np.ones(len(rows)), *smooth[: len(rows) // ROWS_A_REGRESSOR]], axis=1)


def _fitted(sizes: ErrorSizes, distance: np.ndarray, p: float) -> Growth:
    middle = float(np.sqrt(np.median(sizes.squared / sizes.freedom)))
    start = np.log([middle / 2, middle / 2 / np.mean(distance)])
    x = ca.MX.sym("x", 2)
    variance = (ca.exp(x[0]) + ca.exp(x[1]) * ca.DM(distance)) ** 2
    cost = ca.sum1(0.5 * ca.DM(sizes.squared) / variance + 0.5 * ca.DM(sizes.freedom) * ca.log(variance))
    curvature, slope = ca.hessian(cost, x)
    function = ca.Function("cost", [x], [cost, slope, curvature])
    optimum = scipy.optimize.minimize(
        lambda at: float(function(at)[0]), start, jac=lambda at: np.array(function(at)[1]).ravel(), method="L-BFGS-B",
        bounds=np.stack([start - WIDE, start + WIDE], axis=1),
    ).x  # fmt: skip
    inverse = np.linalg.pinv(np.array(function(optimum)[2]), hermitian=True)
    sd = float(np.sqrt(max(inverse[1, 1], 0.0)) * np.exp(optimum[1]))
    return Growth(float(np.exp(optimum[0])), float(np.exp(optimum[1])), sd, p)
