"""Smooth functions of the inputs without a physical meaning: basis functions of a robot's unnamed errors.

Singly they are decoys, which are tested as causes are. Together, with normal amplitudes whose variances the data determine (see
`variance_components`), they are the errors of a model elsewhere: functions of joints, place, payload, time and images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, pairwise
from typing import ClassVar, Literal, TypeVar

import casadi as ca
import numpy as np

from calflow.effects import Effect
from calflow.effects.base import ITS_TORQUE, ActingEffect, JointError, Term
from calflow.effects.board_bent import REACH, bow
from calflow.effects.thermal_growth import GROWTH_SD, grown
from calflow.effects.tracker_scale import TrackerScale
from calflow.effects.warming import WARM_UPS
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import probed
from calflow.estimation.variance_components import USUAL
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.mechanism import Deflection, Dimensions, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SIZE = 3e-4  # rad or m, usual prior standard deviation of an amplitude
LENS_SIZE = 3e-2  # usual slope error of a line of sight at SIGHT, as of a lens that is not the stated one
SIGHT = 0.4  # slope of a line of sight near the edge of an image
ORDERS = 6  # harmonics of a function of one joint
# Powers of the coordinates in the terms of `InImage` and `InPlace`.
_IN_IMAGE = [(i, j) for i in range(4) for j in range(4) if i + j <= 3]
_IN_PLACE = [(i, j, k) for i in range(4) for j in range(4) for k in range(4) if 2 <= i + j + k <= 3]
TORQUE_ORDERS = 2  # harmonics of a function of a joint's torque
SMOOTH_ORDERS = 4  # harmonics of a joint's angle
TINY = 1e-6  # m, of a travel
LEAST_REACH = 0.5  # over which errors of place vary, over the distance of the farthest point from the robot's base
STILL = 1e-9  # derivative by a joint over the largest, below which it is rounding
# Steps of a random walk during the measurement, of equal numbers of rows, besides pauses; a robot warms up steadily.
STEPS, STEPS_OF_ROBOT = 16, 4
STEPS_OF_SESSION = 8  # at least, of a device that is placed anew for each session
STATIONARY = 10  # time constants before the measurement, at which a stationary walk begins


class SmoothFunction(Effect):
    """A smooth function of some inputs, linear in amplitudes with zero prior mean."""

    id: ClassVar[str] = "unexplained"
    title: ClassVar[str] = "unexplained"
    usual: ClassVar[float] = SIZE  # standard deviation of an amplitude
    of_images: ClassVar[bool] = False  # whether it is an error of a camera or its target, not of the robot's position

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs on which it depends."""
        raise NotImplementedError

    @property
    def spectrum(self) -> np.ndarray:
        """Relative standard deviations of its amplitudes as a random function, shape (n_parameters,)."""
        return np.ones(len(self.declared))

    @property
    def units(self) -> Sequence[str]:
        """Units of its amplitudes."""
        raise NotImplementedError

    def parameters(self) -> tuple[Parameter, ...]:
        kind = type(self).__name__
        return tuple(
            Parameter(self.id, kind, str(k), unit, self.usual, -1.0, 1.0) for k, unit in enumerate(self.units, start=1)
        )


@dataclass(frozen=True)
class OfJoints(SmoothFunction):
    """A smooth function of one joint's angle, or of two together (their interaction alone); with no orders a constant, a mean."""

    of: tuple[int, ...] = (0,)
    orders: int = ORDERS

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(f"q{i + 1}" for i in self.of)

    @property
    def spectrum(self) -> np.ndarray:
        return np.tile(self._sizes, len(self.declared) // len(self._sizes))

    @property
    def _sizes(self) -> np.ndarray:
        """Relative standard deviations of `waves`."""
        if not self.orders:
            return np.ones(1)
        return np.repeat(1 / np.arange(1.0, self.orders + 1), 2) if len(self.of) == 1 else np.ones(4)

    def waves(self, q: ca.SX) -> ca.SX:
        """Return waves (n,) of one joint's angle, or products of those of two; a slide's travel counts as half a turn."""
        if not self.orders:
            return ca.SX(1.0)
        turn = turn_of_readings(self.robot)
        first, *second = (q[i] * float(turn[i]) for i in self.of)
        if second:
            return ca.vec(_phases(second[0]) @ _phases(first).T)
        return ca.vec(_phases(first @ ca.DM(range(1, self.orders + 1)).T))


@dataclass(frozen=True)
class JointField(JointError, OfJoints):
    """Errors of some joints' angles (numbers from 0, in order; empty: all) as such functions."""

    erring: tuple[int, ...] = ()

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        waves = ca.vertsplit(self.waves(state.q)) if not self.erring or joint in self.erring else []
        return [Term(f"wave{k + 1}", self.unit(joint), SIZE, 1.0, value) for k, value in enumerate(waves)]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        joint, erring = ca.SX(still.joint), list(self.erring or range(self.robot.n_joints))
        joint[erring] = ca.reshape(p, p.numel() // len(erring), len(erring)).T @ self.waves(state.q)
        return replace(still, joint=joint)


@dataclass(frozen=True)
class OfTorque(JointError, SmoothFunction):
    """An error of one joint (number from 0) as a smooth function of its torque, up to the rated one to either side."""

    erring: int = 0
    orders: int = TORQUE_ORDERS

    @property
    def inputs(self) -> tuple[str, ...]:
        return (f"{ITS_TORQUE}{self.erring + 1}",)

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        if joint != self.erring:
            return []
        waves = ca.vertsplit(ca.vec(_phases(np.pi / 2 * self.load(joint, state) @ ca.DM(range(1, self.orders + 1)).T)))
        return [Term(f"wave{k + 1}", self.unit(joint), SIZE, 1.0, value) for k, value in enumerate(waves)]


@dataclass(frozen=True)
class AlongSlides(JointField):
    """Errors of some joints' angles in proportion to the travel of each slide on which they depend."""

    orders: int = 0

    @property
    def _sizes(self) -> np.ndarray:
        return np.ones(len(self.slides))

    @property
    def slides(self) -> tuple[int, ...]:
        return tuple(i for i in self.of if self.robot.joints[i].kind == "prismatic")

    def waves(self, q: ca.SX) -> ca.SX:
        """Return lines (n,) from -1 to 1 over the travels."""
        low, high = self.robot.limits.T
        half = np.maximum(high - low, TINY) / 2
        return ca.vertcat(*((q[i] - float(low[i])) / float(half[i]) - 1 for i in self.slides))


@dataclass(frozen=True)
class Shift(OfJoints):
    """A shift of the reported point as such a function."""

    @property
    def units(self) -> Sequence[str]:
        return 3 * len(self._sizes) * ["m"]

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point + ca.reshape(p, p.numel() // 3, 3).T @ self.waves(row.q)


class LinkLengths(SmoothFunction):
    """A relative elongation of all links."""

    units, usual = ("1",), GROWTH_SD

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        return grown(self.robot, dims, 1 + p)


Times = TypeVar("Times", ca.SX, ca.DM)

# Quantities of device and robot that may walk in time, as the effects of a constant change.
WALKING: dict[str, Callable[[Robot], Effect]] = {
    "shift": partial(Shift, orders=0), "scale": TrackerScale, "lengths": LinkLengths, "zeros": partial(JointField, orders=0),
}  # fmt: skip


@dataclass(frozen=True)
class Wandering(ActingEffect, SmoothFunction):
    """A step of a quantity's random walk with time, of share times its usual size: see `WALKING`."""

    of: str = "shift"
    clock: Literal["time", "order"] = "time"
    begin: float = 0.0
    end: float = 1.0
    share: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        return (self.clock,)

    @property
    def spectrum(self) -> np.ndarray:
        """Equal standard deviations, which make a whole walk as large as one function at a part's usual variance."""
        return np.full(len(self.declared), USUAL**-0.5)

    @cached_property
    def quantity(self) -> Effect:
        """The effect of a constant change of the quantity."""
        return WALKING[self.of](self.robot)

    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            replace(figure, effect=self.id, prior_sd=self.share * figure.prior_sd)
            for figure in self.quantity.parameters()
        )

    def gone(self, row: Row) -> ca.SX:
        """Return the share of the step that has occurred at a row; structurally zero where the row has no time."""
        raise NotImplementedError

    @property
    def time_constant(self) -> float:
        """Return that of the return to the mean [s]: the longest warm-up's for a robot, infinite for a device."""
        return np.inf if self.clock == "order" or self.quantity.of_measuring() else WARM_UPS[-1]

    def diffusion(self, passed: Times) -> Times:
        """Return the time in which a random walk has the variance that this has after a time [s] (Uhlenbeck and Ornstein 1930)."""
        constant = self.time_constant
        return constant / 2 * (1 - ca.exp(-2 * passed / constant)) if np.isfinite(constant) else passed

    def change_in(self, duration: float) -> float:
        """Return the standard deviation of a random walk's change in a time [s], over the root mean square of this about its mean.

        For unit variance gained per second, its mean square is a sixth of the time, and half the time constant at most.
        """
        return float((6 + 2 * duration / self.time_constant) ** 0.5)

    @property
    def gives_way(self) -> bool:
        return self.quantity.gives_way

    def acting(self, p: ca.SX, row: Row) -> tuple[Effect, ca.SX]:
        """Return the quantity's change, as much of it as has occurred."""
        return self.quantity, p * self.gone(row)


@dataclass(frozen=True)
class InTime(Wandering):
    """A step of a walk, linear from begin to end; mean is its average over the measurement, which belongs to the base.

    session: first and last time of the only session that it concerns; None: one walk goes through all.
    """

    mean: float = 0.0
    session: tuple[float, float] | None = None

    def share_at(self, at: Times) -> Times:
        """Return the share that has occurred and not decayed."""
        gone = ca.fmax(0, ca.fmin(1, (at - self.begin) / (self.end - self.begin)))
        return gone * ca.exp(-ca.fmax(0, at - self.end) / self.time_constant)

    def gone(self, row: Row) -> ca.SX:
        """Return that share, less its average."""
        at = row.time if self.clock == "time" else row.order
        if not at.nnz():
            return ca.SX(1, 1)
        gone = self.share_at(at) - self.mean
        return gone * within(at, self.session) if self.session else gone


@dataclass(frozen=True)
class UnderPayload(SmoothFunction):
    """Changes under one payload: of all joints' zeros, first harmonics, the marker on the tool and the device's place."""

    payload: str = ""

    inputs = ("payload",)

    @property
    def detail(self) -> str:
        return f"under {self.payload}"

    @property
    def units(self) -> Sequence[str]:
        return [joint.unit for joint in self.robot.joints for _ in range(3)] + 6 * ["m"]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        on, n = self._carried(row), self.robot.n_joints
        waves = [ca.vertcat(1, ca.cos(state.q[i]), ca.sin(state.q[i])) for i in range(n)]
        turned = [on * ca.dot(p[3 * i : 3 * i + 3], wave) for i, wave in enumerate(waves)]
        link = ca.SX(still.link)
        link[:3, -1] = on * p[3 * n : 3 * n + 3]
        return replace(still, joint=ca.vertcat(*turned), link=link)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point + self._carried(row) * p[-3:]

    def _carried(self, row: Row) -> ca.SX:
        return row.payload[list(self.robot.payloads).index(self.payload)]


@dataclass(frozen=True)
class InPlace(SmoothFunction):
    """A shift of the reported point by quadratic and cubic terms of its place along each axis; lower ones are geometry's."""

    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    reach: float = 1.0

    inputs = ("x", "y", "z")
    units = 3 * len(_IN_PLACE) * ("m",)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        near = (point - ca.DM(self.centre)) / self.reach
        terms = ca.vertcat(*(near[0] ** i * near[1] ** j * near[2] ** k for i, j, k in _IN_PLACE))
        return point + ca.reshape(p, len(_IN_PLACE), 3).T @ terms


@dataclass(frozen=True)
class InImage(SmoothFunction):
    """A shift of a seen point across its line of sight by its place in the image: distortion beyond the lens model.

    Its terms are those up to cubic ones along both axes.
    """

    of_images = True
    inputs = ("image",)
    units, usual = 2 * len(_IN_IMAGE) * ("1",), LENS_SIZE

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        u, v = (point[axis] / (SIGHT * point[2]) for axis in (0, 1))
        terms = ca.vertcat(*(u**i * v**j for i, j in _IN_IMAGE))
        return point + point[2] * ca.vertcat(ca.reshape(p, len(_IN_IMAGE), 2).T @ terms, 0)


@dataclass(frozen=True)
class OnTarget(SmoothFunction):
    """Errors of the stated places of a target's points: stretches along x and y, skew, and heights xx, xy and yy of a quadric."""

    of_images = True
    inputs = ("target",)
    units = 6 * ("m",)

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        x, y = point[0] / REACH, point[1] / REACH
        return point + ca.vertcat(p[0] * x + p[2] * y, p[1] * y + p[2] * x, bow(p[3:], point))


Part = tuple[tuple[str, ...], list[SmoothFunction]]  # inputs and functions of one variance component


def smooth_functions(problem: LeastSquares, estimate: np.ndarray, data: Measurements) -> list[Part]:
    """Return the parts of the smooth errors: of one joint, two joints, place, payload, and time or order.

    For images the place is that in the image, and that on the target.

    By a joint's angle there are errors of that joint, of the others, and of the point: three parts, as the variance of one does not
    determine another. So it is by two joints' angles. Joints on which no residual depends together, as of two arms, have no joint
    part.
    """
    robot, groups = data.robot, moved_together(problem, estimate)
    bases = list[Part]()
    for i in sorted(set().union(*groups)):
        others = tuple(k for k in _beside(groups, i) if k != i)
        fields = [JointField(robot, (i,), SMOOTH_ORDERS, erring) for erring in ((i,), others) if erring]
        bases += [((f"q{i + 1}",), [function]) for function in (*fields, Shift(robot, (i,), SMOOTH_ORDERS))]
    if pairs := pairs_of(groups):
        fields = [JointField(robot, pair, erring=_beside(groups, *pair)) for pair in pairs]
        bases += [(("joints",), [*fields]), (("joints",), [Shift(robot, pair) for pair in pairs])]
    if not of_images(data):
        bases.append((InPlace.inputs, [of_place(problem.model, estimate, data)]))
    walks = (in_time(data, of) for of in WALKING if of != Wandering.of)
    return bases + beside_joints(problem.model, data) + [(walk[0].inputs, [*walk]) for walk in walks if walk]


def means(functions: Sequence[SmoothFunction]) -> list[SmoothFunction]:
    """Return means of functions that are errors of joints, which a zero imitates, and slopes along slides, which a tilt does."""
    fields = [of for of in functions if isinstance(of, JointField)]
    lines = [AlongSlides(of.robot, of.of, erring=of.erring) for of in fields]
    return [*(replace(of, orders=0) for of in fields), *(line for line in lines if line.slides)]


def is_mean(function: SmoothFunction) -> bool:
    """Whether a function is such a mean or slope."""
    return isinstance(function, OfJoints) and not function.orders


def beside_joints(model: Model, data: Measurements) -> list[Part]:
    """Return the parts by place in an image and on a target, by payload, and by time or order."""
    bases: list[Part] = [(of.inputs, [of]) for of in of_images(data)]
    if loaded := under_payloads(data):
        bases.append((("payload",), [*loaded]))
    if steps := in_time(data, anew=model.by_session):
        bases.append((steps[0].inputs, [*steps]))
    return bases


def moved_together(problem: LeastSquares, estimate: np.ndarray) -> list[frozenset[int]]:
    """Return the groups of joints (from 0) on which a residual depends together, with those before them in their chains."""
    robot = problem.model.robot
    if len(robot.tips) == 1:
        return [frozenset(range(robot.n_joints))]
    n = len(estimate)
    slopes = np.abs(probed(problem, estimate, [JointField(robot, orders=0)])[1][:, n:])
    moved = np.unique(slopes > STILL * slopes.max(), axis=0)
    chains = [frozenset(robot.chain(link)) for link in range(1, robot.n_joints + 1)]
    return [frozenset().union(*(chains[i] for i in np.flatnonzero(row))) for row in moved]


def pairs_of(groups: Sequence[frozenset[int]]) -> list[tuple[int, int]]:
    """Return all pairs of joints within a group."""
    return sorted({pair for group in groups for pair in combinations(sorted(group), 2)})


def _beside(groups: Sequence[frozenset[int]], *joints: int) -> tuple[int, ...]:
    """Return the joints, in order, of all groups that contain the given joints."""
    return tuple(sorted(set().union(*(group for group in groups if group.issuperset(joints)))))


def in_time(data: Measurements, of: str = Wandering.of, anew: bool = False) -> list[InTime]:
    """Return the steps of a quantity's random walk in time, or row by row where no time is known; none where all are of one time.

    If anew, it walks about its mean within each session alone, as a device placed anew for each: all these walks have one variance
    per time, such that the mean square over the rows is that of a single walk.
    """
    clock: Literal["time", "order"] = "time" if "time" in data.given else "order"
    if clock not in data.given or data.table[clock].nunique() < 2:
        return []
    at, walk = data.table[clock].to_numpy(float), Wandering(data.robot, of, clock)
    spans = [at[data.session == session] for session in dict.fromkeys(data.session)] if anew else [at]
    duration = sum(np.ptp(span) * len(span) for span in spans) / len(at)
    number = max(STEPS // len(spans), STEPS_OF_SESSION) if walk.quantity.of_measuring() else STEPS_OF_ROBOT
    steps = ((span, step) for span in spans if np.ptp(span) for step in _steps(walk, span, duration, number))
    return [replace(step, session=(float(span.min()), float(span.max()))) if anew else step for span, step in steps]


def within(at: Times, session: tuple[float, float]) -> Times:
    """Return 1 where a time is within a session, from its first to its last, and 0 elsewhere."""
    return (at >= session[0]) * (at <= session[1])


def _steps(walk: Wandering, at: np.ndarray, duration: float, n: int) -> list[InTime]:
    """Return n steps and pauses of a walk through times (n_rows,), which has a mean square about its mean of 1 in a duration."""
    every = np.unique(at)
    paused = np.flatnonzero(np.diff(every) > np.ptp(at) / n)
    nodes = np.unique(
        [*np.quantile(at, np.linspace(0, 1, n + 1), method="nearest"), *every[paused], *every[paused + 1]]
    )
    if np.isfinite(walk.time_constant):
        # The first step is the initial state of a stationary process.
        nodes = np.append(at.min() - STATIONARY * walk.time_constant, nodes)
    steps = [InTime(walk.robot, walk.of, walk.clock, begin, end) for begin, end in pairwise(nodes.tolist())]
    per_time, times = walk.change_in(duration) / duration**0.5, ca.DM(at)
    return [
        replace(step, share=per_time * float(step.diffusion(ca.DM(step.end - step.begin))) ** 0.5,
                mean=float(np.mean(step.share_at(times).full())))
        for step in steps
    ]  # fmt: skip


def under_payloads(data: Measurements) -> list[UnderPayload]:
    """Return the functions of payload, relative to the first payload or to none."""
    carried = list(dict.fromkeys(data.table["payload"]))
    return [UnderPayload(data.robot, name) for name in carried[1 if all(carried) else 0 :] if name]


def of_place(model: Model, estimate: np.ndarray, data: Measurements) -> InPlace:
    """Return the smooth functions of place over a model's rows."""
    place = model.point(estimate, data.conditions)
    centre, arm = place.mean(axis=0), np.linalg.norm(place - model.robot.base.origin, axis=1).max()
    # Such errors vary over the robot's size: cubic over that of two sockets beside each other, they would be metres elsewhere.
    reach = max(np.abs(place - centre).max(), LEAST_REACH * arm)
    return InPlace(data.robot, tuple(map(float, centre)), float(reach) or 1.0)


def of_images(data: Measurements) -> list[SmoothFunction]:
    """Return the smooth functions of images of a target's points: errors of lens and print."""
    seen = data.in_images and "px_x" in data.table
    return [InImage(data.robot), OnTarget(data.robot)] if seen else []


def turn_of_readings(robot: Robot) -> np.ndarray:
    """Return the factors from joint readings to angles, shape (n_joints,): 1, for slides half a turn over travel [rad/m]."""
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    return np.where(slides, np.pi / np.maximum(np.ptp(robot.limits, axis=1), TINY), 1.0)


def _phases(angles: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(angles), ca.sin(angles))
