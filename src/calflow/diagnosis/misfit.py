"""Misfit: a significant lack of fit, its largest region, structure that no cause explains, and noise that grows with range.

A lack of fit is reported whether any input explains it or not. Its largest region is searched for one input at a time: in ranges
between eighths of the poses, and at each value of labels with few values.

Unexplained structure is in the residual and no cause of the catalogue explains it; it is given with the inputs it depends on.

Decoys are smooth functions of the inputs without a physical meaning. They are tested as causes are, as a family of their own; a
significant decoy is reported as unexplained, never as a cause.

Unexplained structure has suspects: the family of general errors along its input, and causes that failed their test but are too
probable to be ignored.

Noise growth: a test for noise of the measuring device that grows with range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import Any

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background
from calflow.diagnosis.screening import MATERIAL, Score, Screening, by_place
from calflow.effects import Effect
from calflow.effects.base import ITS_ANGLE, Cause
from calflow.estimation.accuracy import distances, errors, judged_unit
from calflow.estimation.lack_of_fit import SIGNIFICANT
from calflow.estimation.noise import MIN_REPEATS, Noise
from calflow.estimation.smooth_functions import (
    SIZE,
    Field,
    JointField,
    Oscillation,
    Shift,
    SmoothFunction,
    moved_together,
    of_place,
    pairs_of,
    under_payloads,
)
from calflow.files.tables import column
from calflow.files.units import METRE
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

PARTS = 8  # quantiles of an input's poses, at which regions begin and end
MAX_REGION_SHARE = 0.5  # largest share of the poses in a region
MIN_REGION_POSES = 4  # poses inside a region, and outside
DRAWS = 499  # permutations of the poses
BY_CHANCE = 0.05  # p-value, over all inputs, above which no region is reported: the misfit is then about uniform
MOST_LEVERAGE = 0.95
LABELS = ("payload", "marker")  # inputs with few values
MOST_PARTS = 3  # unexplained dependences that are reported
POSE = "pose"  # as an input: changes from pose to pose that no other input explains
SUSPECTED = 0.05  # probability from which a cause that failed its test is reported beside unexplained structure
MOMENTS = 20  # parts of the rows, between which a slip may have occurred
FREQUENCIES = 800  # of a disturbance in time, at most
# Highest frequency, in cycles per pose: uneven times resolve more than one cycle between poses (Lomb 1976).
FASTEST = 2.0
RANGE = "range"  # the condition of a row with which noise may grow
STILL = 0.02  # p-value required of the growth of residuals without their smooth part
ROWS_A_REGRESSOR = 4  # rows required for each smooth function that is removed
WIDE = 10.0  # search range of a log standard deviation about its starting value


@dataclass(frozen=True, kw_only=True)
class MisfitRegion:
    """The region with the largest residuals: a range of one input, or one of its few values."""

    input: str = column("q1 … (joints), x, y, z, time, order, payload, marker")
    low: float | None = column("start of the range", "as `unit` says", default=None)
    high: float | None = column("end of the range", "as `unit` says", default=None)
    unit: str = column("of the range", default="")
    value: str = column("the payload or marker", default="")
    there_mm: float | None = column(
        "mean error of the training rows there; null: no lengths were measured", "mm", default=None
    )
    elsewhere_mm: float | None = column("mean error of the others", "mm", default=None)
    error_unit: str = column("the unit of the errors: mm, mrad, px, …", default="mm")
    there: float | None = column("as there_mm, in `error_unit` where that is another", default=None)
    elsewhere: float | None = column("as elsewhere_mm, likewise", default=None)

    @property
    def where(self) -> str:
        """The region in words."""
        if self.value:
            return f"{self.input} is {self.value}"
        joint = self.input[0] == "q" and self.input[1:].isdigit()
        name = (
            f"joint {self.input[1:]}"
            if joint
            else "the row's place in measuring order"
            if self.input == "order"
            else self.input
        )
        return f"{name} is between {_said(self.low)} and {_said(self.high)}{f' {self.unit}' if self.unit else ''}"

    @property
    def words(self) -> str:
        """The region and its errors in words."""
        suffix = "_mm" if self.error_unit == METRE.label else ""
        there, elsewhere = (
            f"{rounded(getattr(self, name + suffix))} {self.error_unit}" for name in ("there", "elsewhere")
        )
        return f"largest where {self.where}: {there} against {elsewhere} elsewhere"


@dataclass(frozen=True)
class Misfit:
    """A significant lack of fit: chi² per degree of freedom, its p-value, and its largest region, if it is not uniform."""

    reduced_chi2: float
    p: float
    region: MisfitRegion | None

    @property
    def times(self) -> float:
        """Residuals over the noise, root mean square."""
        return float(np.sqrt(self.reduced_chi2))


@dataclass(frozen=True)
class _Input:
    """An input along which regions are searched for: its values in display units, or its labels, one per row."""

    name: str
    values: np.ndarray
    unit: str = ""

    def regions(self) -> Iterator[np.ndarray]:
        """Yield the mask of rows in each region."""
        if self.values.dtype == object:
            yield from (self.values == value for value in dict.fromkeys(self.values))
            return
        ends = np.unique(np.quantile(self.values, np.linspace(0, 1, PARTS + 1)))
        for low, high in combinations(ends, 2):
            yield (self.values >= low) & (self.values <= high)


@dataclass(frozen=True)
class _Worst:
    """The region of an input with the largest residuals: mask of its rows (n_rows,), likelihood ratio, and p-value."""

    of: _Input
    inside: np.ndarray
    ratio: float
    chance: float


def misfit(fitted: Fitted, rng: np.random.Generator) -> Misfit | None:
    """Return a fitted model's lack of fit; None where the noise explains the residuals, or the noise is unknown."""
    lack = fitted.lack
    if not (fitted.noise.known and lack.p < SIGNIFICANT and lack.reduced_chi2 > 1):
        return None
    return Misfit(lack.reduced_chi2, lack.p, largest(fitted, rng))


def largest(fitted: Fitted, rng: np.random.Generator) -> MisfitRegion | None:
    """Return the region with the largest residuals of a fitted model; None where it is not significant.

    Mean squared whitened residuals inside and outside a region are compared as variances, by their likelihood ratio; its p-value is
    by permutation of the poses (Fisher 1935), times the number of inputs.
    """
    studentised, inputs = _studentised(fitted), _inputs(fitted)
    squared, number = np.nansum(studentised**2, axis=1), np.isfinite(studentised).sum(axis=1)
    tried = [_worst(candidate, squared, number, fitted.poses, rng) for candidate in inputs]
    significant = [candidate for candidate in tried if candidate and candidate.chance * len(inputs) <= BY_CHANCE]
    if not significant:
        return None
    worst = min(significant, key=lambda candidate: (candidate.chance, -candidate.ratio))
    return _region(worst.of, worst.inside, fitted)


def _worst(
    candidate: _Input, squared: np.ndarray, number: np.ndarray, poses: np.ndarray, rng: np.random.Generator
) -> _Worst | None:
    """Return an input's region with the largest residuals, None without any; rows of a pose are permuted together."""
    groups = poses if _constant(candidate.values, poses) else np.arange(len(squared))
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    inside = np.array([region[first] for region in candidate.regions()], dtype=bool).reshape(-1, len(first))
    size = inside.sum(axis=1)
    inside = inside[(size >= MIN_REGION_POSES) & (size <= MAX_REGION_SHARE * len(first))]
    if not len(inside):
        return None
    total, count = np.bincount(group, squared), np.bincount(group, number)
    orders = np.array([np.arange(len(first)), *(rng.permutation(len(first)) for _ in range(DRAWS))]).T
    ratio = _likelihood_ratio(inside, total[orders], count[orders])  # (n_regions, 1 + DRAWS)
    best = ratio.max(axis=0)
    return _Worst(candidate, inside[int(ratio[:, 0].argmax())][group], float(best[0]), float((best >= best[0]).mean()))


def _studentised(fitted: Fitted) -> np.ndarray:
    """Return each row's studentised residuals (n_rows, n_units), nan where a row has fewer."""
    every = np.full((len(fitted.data), max(len(observed.units) for observed in fitted.model.observations)), np.nan)
    for rows, residual, jacobian in fitted.problem.linearised(fitted.fit.estimate):
        leverage = np.einsum("rai,ij,raj->ra", jacobian, fitted.fit.covariance, jacobian, optimize=True)
        freed = residual / np.sqrt(np.maximum(1 - leverage, 1 - MOST_LEVERAGE))
        every[rows[:, None], np.arange(residual.shape[1])] = freed
    return every


def _likelihood_ratio(inside: np.ndarray, total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return twice the log likelihood ratio of two variances against one, (n_regions, n_orders); zero if smaller inside.

    inside (n_regions, n_groups) marks groups, total and count (n_groups, n_orders) are their sums of squares and numbers.
    """
    within, n = inside @ total, inside @ count
    beside, m = total.sum(axis=0) - within, count.sum(axis=0) - n
    even = (within + beside) / (n + m)
    ratio = (n + m) * np.log(even) - n * np.log(within / n) - m * np.log(beside / m)
    return np.where(within / n > beside / m, ratio, 0.0)


def _inputs(fitted: Fitted) -> list[_Input]:
    """Return the inputs along which regions are searched for: joints, place, time or order, payloads and markers."""
    data: Measurements = fitted.data
    angles = data.joints @ data.robot.reading_matrix.T
    inputs = []
    for i, joint in enumerate(data.robot.joints):
        shown, factor = joint.shown
        inputs.append(_Input(f"q{i + 1}", factor * angles[:, i], shown))
    place = 1e3 * fitted.model.point(fitted.fit.estimate, data.conditions)
    inputs += [_Input(axis, place[:, i], "mm") for i, axis in enumerate("xyz")]
    for name, unit in (("time", "s"), ("order", "")):
        if name in data.given:
            inputs.append(_Input(name, data.table[name].to_numpy(float), unit))
            break
    labels = [_Input(name, data.table[name].astype(str).to_numpy(object)) for name in LABELS if name in data.table]
    return inputs + [label for label in labels if len(set(label.values)) > 1]


def _constant(values: np.ndarray, groups: np.ndarray) -> bool:
    """Whether all rows of each group have the same value."""
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    return bool((values == values[first][group]).all())


def _region(candidate: _Input, inside: np.ndarray, fitted: Fitted) -> MisfitRegion:
    unit = judged_unit(leading_units(fitted.data))
    size = unit.shown(distances(errors(fitted.model, fitted.fit.estimate, fitted.data)))
    there, elsewhere = float(np.nanmean(size[inside])), float(np.nanmean(size[~inside]))
    suffix = "_mm" if unit == METRE else ""
    figures: dict[str, Any] = {f"there{suffix}": there, f"elsewhere{suffix}": elsewhere, "error_unit": unit.label}
    if candidate.values.dtype == object:
        return MisfitRegion(input=candidate.name, value=str(candidate.values[inside][0]), **figures)
    low, high = float(candidate.values[inside].min()), float(candidate.values[inside].max())
    return MisfitRegion(input=candidate.name, low=low, high=high, unit=candidate.unit, **figures)


def _said(value: float | None) -> str:
    """Return a value rounded as the ends of a range need."""
    return "" if value is None else f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


@dataclass(frozen=True)
class UnexplainedStructure:
    """A dependence that no cause explains: its inputs, family-wise p-value, share of chi², and basis functions.

    along: the inputs on which a part of it depends alone; suspects: the causes that it may be. As for a cause, a share below
    MATERIAL is too small to matter, however many rows show it.
    """

    inputs: tuple[str, ...]
    p: float
    share: float
    functions: tuple[Effect, ...]
    detail: str = ""
    along: tuple[str, ...] = ()
    suspects: tuple[Cause, ...] = ()


def suspected(left: Sequence[UnexplainedStructure], scores: Sequence[Score[Cause]]) -> tuple[UnexplainedStructure, ...]:
    """Return the structures with their suspects, the likeliest first; scores are those of all candidates beside the model.

    The family of errors along an input is suspected wherever a part depends on that alone. Any other cause is reported with the
    strongest dependence: a priori one of them is as probable as none.
    """
    places = by_place(scores)
    odds = {place: float(np.exp(-cost / 2)) / len(places) for place, (cost, _) in places.items()}
    likeliest = sorted(places, key=lambda place: -odds[place])
    least = SUSPECTED * (1 + sum(odds.values()))
    structures = []
    for first, structure in zip((True, *[False] * len(left)), left, strict=False):
        causes = [(places[place][1].cause, first and odds[place] >= least) for place in likeliest]
        suspects = (cause for cause, likely in causes if likely or _is_any_error_along(cause, structure.along))
        structures.append(replace(structure, suspects=tuple(suspects)))
    return tuple(structures)


def _is_any_error_along(cause: Cause, inputs: tuple[str, ...]) -> bool:
    """Whether a cause is of the family of general errors along one of these inputs."""
    own = {f"q{cause.joint}" if name == ITS_ANGLE else name for name in cause.effect.named_in()}
    return not own.isdisjoint(inputs)


def _alone(*parts: tuple[str, ...]) -> tuple[str, ...]:
    """Return the inputs on which a part depends alone."""
    return tuple(dict.fromkeys(part[0] for part in parts if len(part) == 1))


def unexplained(
    fitted: Fitted,
    significance: float,
    rng: np.random.Generator,
    say: Callable[[str], None],
    at_rest: Sequence[UnexplainedStructure] = (),
    beside: Background | None = None,
) -> list[UnexplainedStructure]:
    """Return the significant dependences of a fitted model's residual on inputs, the strongest first.

    Single functions are tested first, as they show a sharp dependence best; then the background as a whole. Joints that do not
    repeat, at_rest, are reported only where no function is significant beside their errors, beside, and then alone: to tests that
    take rows as independent, errors of a pose look like a dependence on many inputs.
    """
    accepted: list[UnexplainedStructure] = []
    surest = sorted(at_rest, key=lambda structure: structure.p)
    alone = beside is not None and surest[0].p < significance
    if alone and any(part.p < significance for part in _single(replace(fitted, background=beside, shared=0.0), rng)):
        alone = False
    if not alone:
        surest = [*_single(replace(fitted, background=None), rng), *_together(fitted), *_of_poses(fitted)]
    for structure in surest:
        if structure.p >= significance or structure.share < MATERIAL or len(accepted) == MOST_PARTS:
            continue
        if not any(set(structure.inputs) - {POSE} & set(other.inputs) for other in accepted):
            accepted.append(structure)
            say(f"left over, depends on {' and '.join(structure.inputs)}: p = {structure.p:.2g}")
    return accepted


def _single(fitted: Fitted, rng: np.random.Generator) -> list[UnexplainedStructure]:
    screening = Screening(fitted.regressors(decoys(fitted)))
    family = screening.family(rng)
    tested = []
    for score in screening.scores:
        decoy = score.cause.effect
        assert isinstance(decoy, SmoothFunction)
        tested.append(
            UnexplainedStructure(
                decoy.inputs, family.p(score), score.share, (score.cause,), score.cause.detail, _alone(decoy.inputs)
            )
        )
    return sorted(tested, key=lambda structure: structure.p)


def _together(fitted: Fitted) -> list[UnexplainedStructure]:
    """Return the test of the background as a whole, corrected for every choice of as many parts.

    Twice the log likelihood ratio is a mixture of chi² with at most as many degrees of freedom as variances and correlation
    lengths: half of each variance's distribution is at its bound of zero (Self and Liang 1987), where lengths do not matter.
    """
    left = fitted.background
    if left is None:
        return []
    n = len(left.inputs)
    lengths = sum(len(part.lengths) for part in left.functions if isinstance(part, Field))
    p = comb(left.tried, n) * 0.5**n * float(scipy.stats.chi2.sf(left.gain, n + lengths))
    inputs = tuple(dict.fromkeys(name for part in left.inputs for name in part))
    share = -float(np.expm1(-left.gain / fitted.fit.residual.size))
    return [UnexplainedStructure(inputs, min(1.0, p), share, left.functions, along=_alone(*left.inputs))]


def _of_poses(fitted: Fitted) -> list[UnexplainedStructure]:
    """Return the test of errors that the markers of a pose share; a correlation of zero is at its bound, as variances are."""
    if not (fitted.intraclass and fitted.intraclass_likelihood):
        return []
    return [
        UnexplainedStructure(
            (POSE,), float(scipy.stats.chi2.sf(fitted.intraclass_likelihood.gain, 1)) / 2, fitted.intraclass, ()
        )
    ]


@dataclass(frozen=True)
class Since(SmoothFunction):
    """A step of all joints' zeros, and of the marker on the tool, from a row on."""

    moment: float = 0.5

    @property
    def inputs(self) -> tuple[str, ...]:
        """The order of the rows."""
        return ("order",)

    @property
    def detail(self) -> str:
        """The row of the step, in words."""
        return f"since row {int(np.floor(self.moment)) + 1} in measuring order"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the joints' offsets, and the marker's."""
        units = [joint.unit for joint in self.robot.joints] + ["m"] * 3
        return tuple(
            Parameter(self.id, "since", f"offset{k + 1}", unit, SIZE, -1.0, 1.0) for k, unit in enumerate(units)
        )

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection of the joints, and a shift of the flange with its load."""
        after, n = row.order > self.moment, self.robot.n_joints
        link = ca.SX(still.link)
        link[:3, -1] = p[n:] * after
        return replace(still, joint=p[:n] * after, link=link)


def decoys(fitted: Fitted) -> list[SmoothFunction]:
    """Return the decoys for a fitted model's rows."""
    data, robot = fitted.data, fitted.data.robot
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    chosen: list[SmoothFunction] = [JointField(robot, (i,)) for i in turning]
    chosen += [Shift(robot, (i,)) for i in turning]
    pairs = pairs_of(moved_together(fitted.problem, fitted.fit.estimate))
    chosen += [kind(robot, pair) for pair in pairs if set(pair) <= set(turning) for kind in (JointField, Shift)]
    chosen += of_place(fitted.model, fitted.fit.estimate, data)
    chosen += under_payloads(data)
    if "order" in data.given:
        order = np.unique(data.table["order"].to_numpy(float))
        chosen += [Since(robot, float(moment)) for moment in np.quantile(order, np.arange(1, MOMENTS) / MOMENTS)]
    if "time" in data.given:
        chosen += [Oscillation(robot, float(rate)) for rate in _rates(data.table["time"].to_numpy())]
    return chosen


def _rates(time: np.ndarray) -> np.ndarray:
    """Return angular frequencies from one cycle per session to the highest, half a cycle apart."""
    span = float(np.ptp(time))
    if span <= 0:
        return np.array([])
    turns = FASTEST * len(np.unique(time))
    return 2 * np.pi / span * np.linspace(1.0, turns, min(FREQUENCIES, int(2 * turns)))


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

    stated (n,) [m] is the assumed noise of the device there.
    """

    squared: np.ndarray
    freedom: np.ndarray
    stated: np.ndarray
    distance: np.ndarray


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
    """Return the p-value of growth by rank correlation (Spearman 1904), which is valid for any tails of the noise."""
    beyond = spread.squared / spread.freedom / spread.stated**2
    return float(scipy.stats.spearmanr(beyond, spread.distance, alternative="greater").pvalue)


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
        scatter.squared, scatter.freedom, (noise.sigma * np.sqrt(data.repeats))[usable], distance[usable]
    )


def _left(fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Return the studentised residuals of positions observed from outside, times the noise (n, 3) [m], and their rows (n,)."""
    # Other rows have no range, or a stated noise that grows with it.
    positions = [observed.units[:3] == (METRE,) * 3 and observed.from_outside and not observed.series.beam
                 for observed in fitted.model.observations]  # fmt: skip
    rows = np.flatnonzero(np.array(positions)[fitted.data.series_number])
    size = fitted.noise.total * np.sqrt(fitted.data.repeats)
    return _studentised(fitted)[rows, :3] * size[rows, None], rows


def _by_range(fitted: Fitted, error: np.ndarray, rows: np.ndarray) -> SpreadByRange:
    """Return the errors (n, 3) [m] of rows (n,) as a spread."""
    stated = (fitted.device.sigma * np.sqrt(fitted.data.repeats))[rows]
    distance = fitted.data.table[RANGE].to_numpy()[rows]
    return SpreadByRange((error**2).sum(axis=1), np.full(len(rows), 3.0), stated, distance)


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
