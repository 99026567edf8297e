"""Extrapolation: readings beyond the measured range, and a model's errors past a measured travel and at other times.

Past its travel an angle error curve is another one of its size, and at other times device and robot drift on. A smooth curve is
estimated as zero between readings, so that its own root mean square depends on how densely the travel was measured. Its size is
that of its posterior as a Gaussian process instead, averaged over the scale of its prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
import scipy

from calflow.effects.axis_straightness import AxisStraightness, about_carriage
from calflow.effects.base import OF_THE_FRAME, ActingEffect, Effect, JointError, Term, effect_class
from calflow.effects.cause import Cause
from calflow.effects.smooth_curve import Travel
from calflow.effects.step_change import StepChange
from calflow.effects.warming import Warming, heat_lost
from calflow.estimation.error_model import ErrorModel, SmoothVariances, usual_sizes
from calflow.estimation.fit import Fit
from calflow.estimation.needed_conditions import depended_on
from calflow.estimation.smooth_functions import SIZE, InTime, OfJoints, SmoothFunction, Wandering, in_time, within
from calflow.estimation.variance_components import SIZES, TEMPERED
from calflow.files.plugins import subclasses
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Dimensions, Row, State

CANDIDATE_SIZES = np.geomspace(SIZES.min(), SIZES.max(), 65)  # over the usual one
MIN_REDUCTION = 1e-12  # least relative reduction of a variance by the data
MOMENT = 1.0  # s after the measurement, within which the shift by a cause grows to its full value
FADE = 0.05  # share of a measured travel beyond its ends within which its curve fades
BEYOND_WAVES = 8  # frequencies of a curve beyond its travel, each with cosine and sine
NEVER_YET = 1e15, 2e15  # s, between which a step comes that has not come at any row
WARM = 100.0  # time constants after which a robot is warm
BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted range,
LEAST_BEYOND = 0.01  # and by so much in any case [rad, or m]: the range of a joint that stood still is none
DEPENDS = 0.5  # probability that a smooth error depends on a further joint


@dataclass(frozen=True)
class Later(Wandering):
    """The continuation of a walk after its end, and before its begin, with the same variance per time.

    change: standard deviation of its change in the duration of the measurement; any_time: that of its value at a row without time;
    both over the usual one. sessions: first and last time of those measured by a device that is placed anew for each, whose change
    is the same at any other time; empty: it grows as the root of the time that has passed.
    """

    change: float = 1.0
    any_time: float = 0.0
    sessions: tuple[tuple[float, float], ...] = ()

    def gone(self, row: Row) -> ca.SX:
        """Return the standard deviation at a row."""
        if not (at := row.time).nnz():
            return ca.SX(self.any_time) if self.any_time else ca.SX(1, 1)
        if self.sessions:
            return self.change * (1 - sum((within(at, session) for session in self.sessions), ca.SX(0)))
        beyond = ca.fmax(0, ca.fmax(self.begin - at, at - self.end))
        return self.change * ca.sqrt(self.diffusion(beyond) / ((self.end - self.begin) or 1.0))


@dataclass(frozen=True)
class Elsewhere(ActingEffect, SmoothFunction):
    """Another draw of a function of some joints, as far as other joints are beyond their measured ranges.

    Whether it depends on such a joint too is as likely as not. If it does, it did not show within the range: where any scale is as
    likely as any other, it has changed within a distance beyond with the probability distance / (range + distance).

    The function is given by its class's name and its figures (see `Effect.figures_text`), the ranges by joint [rad, or m].
    """

    kind: str = "Shift"
    function: str = "{}"
    ranges: tuple[tuple[float, float], ...] = ()

    @cached_property
    def same(self) -> OfJoints:
        kinds = {kind.__name__: kind for kind in subclasses(OfJoints)}
        return kinds[self.kind].of_figures(self.robot, self.function)

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.same.inputs

    @property
    def spectrum(self) -> np.ndarray:
        return self.same.spectrum

    @property
    def units(self) -> Sequence[str]:
        return [parameter.unit for parameter in self.same.parameters()]

    @property
    def gives_way(self) -> bool:
        return self.same.gives_way

    def share(self, q: ca.SX) -> ca.SX:
        """Return the probability that the function is another one at joint readings."""
        same = ca.SX(1.0)
        for joint, (low, high) in enumerate(self.ranges):
            if joint not in self.same.of:
                beyond = ca.fmax(0, ca.fmax(low - q[joint], q[joint] - high))
                same *= 1 - DEPENDS * beyond / (max(high - low, LEAST_BEYOND) + beyond)
        return 1 - same

    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the function, times the root of that probability."""
        return self.same, p * ca.sqrt(self.share(row.q))


@dataclass(frozen=True)
class Cooling(SmoothFunction):
    """What a warm-up has lost after the measurement's end [s], about the mean of robots that work on and that stand by then.

    The warm-up is given by its effect's id, its figures as of a robot that works (see `Effect.figures_text`), part and growth.
    """

    effect: str = ""
    once: str = "{}"
    part: str = ""
    growth: float = 0.0
    end: float = 0.0

    inputs = ("time",)
    units, usual = ("1",), 1.0

    @cached_property
    def warming(self) -> Warming:
        kind = effect_class(self.effect)
        assert kind is not None
        assert issubclass(kind, Warming)
        return kind.of_figures(self.robot, self.once)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the standard deviation of the loss."""
        if not row.time.nnz():
            return dims
        cause, constant = Cause(self.robot, self.warming, self.part), self.warming.constant
        lost = heat_lost(row.time - self.end, constant)[1]
        return cause.dimensions(self.growth * p * lost, dims, replace(row, time=ca.SX(WARM * constant)))


@dataclass(frozen=True)
class Undated(ActingEffect, SmoothFunction):
    """A step of the robot between two fitted rows, at a row in the time between: it acts already, or does not.

    The step is given by its effect's id, its figures (see `Effect.figures_text`), part and fitted values.
    """

    effect: str = ""
    step: str = "{}"
    part: str = ""
    values: tuple[float, ...] = ()

    inputs = ("time",)
    units, usual = ("1",), 1.0

    @cached_property
    def _step(self) -> StepChange:
        kind = effect_class(self.effect)
        assert kind is not None
        assert issubclass(kind, StepChange)
        return kind.of_figures(self.robot, self.step).later(None)

    @cached_property
    def _before(self) -> Cause:
        return Cause(self.robot, replace(self._step, between=NEVER_YET), self.part)

    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the step that is to come, with its values times the standard deviation of whether it is."""
        to_come = self._step.to_come(row)
        return self._before, ca.DM(self.values) * p * ca.sqrt(to_come * (1 - to_come))


@dataclass(frozen=True)
class Beyond(SmoothFunction):
    """A joint's error beyond the measured travel, low to high, as independent curves of a correlation length [rad, or m].

    Their waves have the frequencies of a Matern 5/2 process of that length, which follow a Student t distribution.
    """

    joint: int = 0
    low: float = 0.0
    high: float = 0.0
    length: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        return (f"q{self.joint + 1}",)

    def waves(self, q: ca.SX) -> ca.SX:
        """Return waves (n,) that reach full size a twentieth of the travel beyond its ends, where a measured curve fades."""
        beyond = ca.fmax(self.low - q, 0) + ca.fmax(q - self.high, 0)
        rates = scipy.stats.t(5).ppf((1 + np.arange(0.5, BEYOND_WAVES) / BEYOND_WAVES) / 2) / self.length
        angle = ca.DM(rates) * q
        return ca.fmin(beyond / (FADE * (self.high - self.low)), 1) * ca.vertcat(ca.cos(angle), ca.sin(angle))


@dataclass(frozen=True)
class BeyondTravel(JointError, Beyond):
    """The error of a joint's angle, with a standard deviation [rad]."""

    size_beyond: float = SIZE

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        waves = ca.vertsplit(self.waves(state.q[joint])) if joint == self.joint else []
        size = self.size_beyond / BEYOND_WAVES**0.5
        return [Term(f"wave{k + 1}", self.unit(joint), size, 1.0, wave) for k, wave in enumerate(waves)]


@dataclass(frozen=True)
class BeyondRail(Beyond):
    """A carriage's errors along and about three axes; shift [m] and turn [rad] are their standard deviations per axis."""

    shift: float = SIZE
    turn: float = 0.0

    @property
    def spectrum(self) -> np.ndarray:
        """The sizes of shifts, then of turns, over an amplitude's usual one."""
        sizes = [self.shift, *([self.turn] if self.turn else [])]
        return np.repeat(sizes, 6 * BEYOND_WAVES) / (SIZE * BEYOND_WAVES**0.5)

    @property
    def units(self) -> Sequence[str]:
        return ["m"] * (6 * BEYOND_WAVES) + (["rad"] * (6 * BEYOND_WAVES) if self.turn else [])

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        waves = self.waves(state.q[self.joint])
        bearing = ca.SX(still.bearing)
        off = ca.reshape(p, waves.numel(), p.numel() // waves.numel()).T @ waves
        bearing[: off.numel(), self.joint] = about_carriage(self.robot, self.joint, off, state)
        return replace(still, bearing=bearing)


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
        return cls(estimate, covariance, usual, float(ca.evalf(cause.size_of(ca.SX(usual)))), travel)

    @cached_property
    def weight(self) -> np.ndarray:
        """Posterior probability of each of CANDIDATE_SIZES, (n_sizes,)."""
        return _size_weights(self.estimate, np.diag(self.covariance), self.usual)

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


def _size_weights(estimate: np.ndarray, variance: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Return the posterior probability of each of CANDIDATE_SIZES of amplitudes, (n_sizes,).

    The sum of squares of the shrunken estimates is approximately a scaled chi-squared variable (Satterthwaite 1946); the prior of
    sizes is that of causes.
    """
    told = np.maximum(usual**2 - variance, MIN_REDUCTION * usual**2)
    expected = told / usual**2 * (CANDIDATE_SIZES[:, None] ** 2 * told + variance)
    whole = expected.sum(axis=1)
    freedom = whole**2 / (expected**2).sum(axis=1)
    logs = scipy.stats.chi2.logpdf(estimate @ estimate * freedom / whole, freedom)
    logs += np.log(freedom / whole) - np.log(np.maximum(CANDIDATE_SIZES, 1.0))
    return np.asarray(scipy.special.softmax(logs))


def beyond_measured(errors: ErrorModel, sizes: SmoothVariances, variance: np.ndarray) -> ErrorModel:
    """Return an error model extended beyond the measurement: curves past their travel, and drifts as random walks in time.

    A cause of the device's frame is a drift, too: its walk has the variance estimated without that cause, and starts from the
    cause's last value; a step may be an event instead (see `_wandered`). During the measurement the cause describes it, and it is
    no error of the robot. A device that is placed anew for each session wanders in a further one as in those measured. A warm-up
    goes on, but the robot may be switched off. variance (n_parts,) is of each part of sizes.
    """
    result, data, left = sizes.result, sizes.data, _walks(sizes, variance)
    angles = data.joint_angles
    ranges = tuple(zip(angles.min(axis=0).tolist(), angles.max(axis=0).tolist(), strict=True))
    # Where all other joints were measured up to their limits a function is the same: another one would only cost time.
    roaming = set(np.flatnonzero(beyond(data.robot.limits.T, angles).any(axis=0)))
    of_joints = errors.only(lambda function: isinstance(function, OfJoints) and not roaming <= set(function.of))
    others = [Elsewhere(data.robot, type(of).__name__, of.figures_text, ranges) for of in of_joints.functions]
    errors = errors.with_functions(others, of_joints.sd)
    further = [*_beyond_causes(result, data)]
    errors = errors.with_functions(further, usual_sizes(result.model, further))
    # Which session it was says all of its frame: the next one's is placed anew.
    causes = [
        effect for effect in result.model.effects if effect.family == OF_THE_FRAME and "session" not in effect.needs
    ]
    steps = in_time(data)
    if not steps or not (causes or any(left.values())):
        return errors
    by_order = steps[0].clock == "order"
    if by_order:
        # The order starts anew in each measurement.
        errors = errors.only(lambda function: not isinstance(function, InTime))
    begin, end, anew = steps[0].begin, steps[-1].end, result.model.by_session
    walks = _wandered(sizes, causes) if causes else left
    for of, walk in walks.items():
        functions: list[SmoothFunction]
        share = 1.0
        if by_order:
            # With causes twice the variance: their drift, extrapolated to other rows, and the drift there are independent.
            functions, share = [*in_time(data, of)], walk * (np.sqrt(2) if causes else 1.0)
        elif anew and of == Wandering.of:
            spans = data.table["time"].groupby(data.session).agg(["min", "max"])
            sessions = tuple(spans.itertuples(index=False, name=None))
            functions = [Later(data.robot, of, change=walk, any_time=left[of], sessions=sessions)]
        else:
            change = walk * Wandering(data.robot, of).change_in(end - begin)
            functions = [Later(data.robot, of, begin=begin, end=end, change=change, any_time=left[of])]
        # Functions of zero variance would only cost time at every predicted row.
        if walk or left[of]:
            errors = errors.with_functions(functions, share * usual_sizes(result.model, functions))
    if causes and not by_order and not anew:
        slope = _moved(causes, result, data)
        come = [InTime(data.robot, begin=end, end=end + MOMENT)]
        sd = usual_sizes(result.model, come)
        slope /= sd[:, None]
        errors = errors.with_functions(come, sd, (slope @ (result.estimate + errors.offset), -slope))
    return errors


def _beyond_causes(result: Fit, data: Measurements) -> Iterator[SmoothFunction]:
    """Yield what is not known of causes: of curves past their travel, of warm-ups past the end, and when a step was."""
    model = result.model
    for cause in model.causes:
        own, effect = model.columns(cause), cause.effect
        if curve := Curve.of(cause, result.estimate[own], result.covariance[np.ix_(own, own)]):
            at = curve.travel
            yield BeyondTravel(data.robot, cause.joint - 1, at.low, at.high, at.length, curve.rms_elsewhere)
        if isinstance(effect, StepChange) and "time" in depended_on(replace(model, effects=(cause.later(None),))):
            values = tuple(map(float, model.values(cause, result.estimate)))
            yield Undated(data.robot, cause.id, effect.figures_text, cause.part, values)
        if isinstance(effect, AxisStraightness):
            yield _beyond_rail(cause, effect, result)
        if isinstance(effect, Warming) and effect.constant and not effect.of_measuring():
            growth, end = float(model.values(cause, result.estimate)[0]), float(data.table["time"].max())
            once = replace(effect, pauses=(), until=np.inf).figures_text
            yield Cooling(data.robot, cause.id, once, cause.part, growth, end)


def _beyond_rail(cause: Cause, rail: AxisStraightness, result: Fit) -> BeyondRail:
    """Return the continuation of a rail's curves past their ends, as large as these."""
    own, units = result.model.columns(cause), np.array([parameter.unit for parameter in cause.declared])
    estimate, variance = result.estimate[own], np.diag(result.covariance)[own]
    usual = np.array([parameter.prior_sd for parameter in cause.declared])

    def over_usual(unit: str) -> float:
        weight = _size_weights(estimate[units == unit], variance[units == unit], usual[units == unit])
        return float(np.sqrt(weight @ CANDIDATE_SIZES**2))

    joint = cause.joint - 1
    length = rail.length * (rail.high[joint] - rail.low[joint])
    shift, turn = rail.shift * over_usual("m"), rail.turn * over_usual("rad") if rail.turning else 0.0
    return BeyondRail(rail.robot, joint, *rail.ends(joint), length, shift, turn)


def _wandered(sizes: SmoothVariances, causes: Sequence[Effect]) -> dict[str, float]:
    """Return the walks (see `_walks`) of which causes of the device's frame are a part.

    Steps are a part of a walk, or events beside one that do not recur: the mean square is weighted by the tempered evidence of
    either, steps between any two rows being equally likely.
    """
    whole = sizes.without(causes)
    walks = _walks(whole, whole.variance)
    events = [cause for cause in causes if isinstance(cause, Cause) and isinstance(cause.effect, StepChange)]
    if not events:
        return walks
    drifts = [cause for cause in causes if cause not in events]
    beside = sizes.without(drifts) if drifts else sizes
    odds = TEMPERED * (whole.cost - beside.cost) / 2 - len(events) * np.log(len(sizes.data))
    share, left = scipy.special.expit(odds), _walks(beside, beside.variance)
    return {of: float(np.sqrt((1 - share) * walk**2 + share * left[of] ** 2)) for of, walk in walks.items()}


def _walks(sizes: SmoothVariances, variance: np.ndarray) -> dict[str, float]:
    """Return the standard deviation of each quantity's random walk in time, over the usual one; 0 without a walk."""
    level = sizes.components.level(variance)
    return {
        functions[0].of: float(np.sqrt(level * own))
        for (_, functions), own in zip(sizes.kinds, variance, strict=True)
        if isinstance(functions[0], InTime)
    }


def _moved(causes: Sequence[Effect], result: Fit, data: Measurements) -> np.ndarray:
    """Return the derivatives of the mean shift of reported points, by causes at the end of the measurement, (3, n) [m]."""
    model = result.model
    last = {name: data.table[name].max() for name in ("time", "order") if name in data.table}
    rows = replace(data, table=data.table.assign(**last)).conditions
    of_causes = np.isin(np.arange(len(result.estimate)), np.concatenate([model.columns(cause) for cause in causes]))
    return np.asarray(model.position_jacobian(result.estimate, rows).mean(axis=0) * of_causes)


def extrapolation(data: Measurements) -> tuple[int, ...]:
    """Return the numbers of the joints whose held-out readings lie beyond the fitted range: held-out accuracy is extrapolation."""
    if not data.held_out.any():
        return ()
    travel = np.ptp(data.joints[data.train | data.held_out], axis=0)
    outside = beyond(data.joints[data.held_out], data.joints[data.train], travel).any(axis=0)
    return tuple(int(i) + 1 for i in np.flatnonzero(outside))


def beyond(readings: np.ndarray, measured: np.ndarray, travel: np.ndarray | None = None) -> np.ndarray:
    """Return the mask of readings (n_rows, n_joints) outside a measured range by over a tenth of travel, by default of that."""
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = np.maximum(BEYOND * (high - low if travel is None else travel), LEAST_BEYOND)
    return np.asarray((readings < low - margin) | (readings > high + margin))
