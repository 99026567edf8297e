"""Smooth functions of the inputs without a physical meaning: what a robot may err by that nobody can name.

One at a time they are decoys, which are tested as causes are. Together, with random amplitudes whose sizes the data tell (see
`variance_components`), they are what a model errs by elsewhere: functions of joints, place, payload and time, and of images. The
diagnosis weighs causes against a field of all joints together in the place of those of joints and place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import ClassVar, Literal

import casadi as ca
import numpy as np
import scipy

from calflow.effects import Effect
from calflow.effects.base import JointError, Term
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

SIZE = 3e-4  # rad or m, of a function before any data
LENS_SIZE = 3e-2  # of a line of sight, at SIGHT from the middle of an image: of a lens that is stated and is another
SIGHT = 0.4  # across a line of sight over along it: about where an image ends
ORDERS = 6  # of a function of one joint


class SmoothFunction(Effect):
    """A smooth function of some inputs."""

    id: ClassVar[str] = "unexplained"
    title: ClassVar[str] = "unexplained"
    of_images: ClassVar[bool] = False  # whether it is a camera's or its target's: where the robot is it says nothing of

    @property
    def inputs(self) -> tuple[str, ...]:
        """What it depends on."""
        raise NotImplementedError

    @property
    def spectrum(self) -> np.ndarray:
        """How large each of its waves is beside the others in what is smooth, shape (n_parameters,)."""
        return np.ones(len(self.declared))

    def amplitudes(
        self, part: str, symbols: Iterable[str], unit: str = "m", usual: float = SIZE
    ) -> tuple[Parameter, ...]:
        """Return a part's amplitudes, which are of a usual size about nothing."""
        return tuple(Parameter(self.id, part, symbol, unit, usual, -1.0, 1.0) for symbol in symbols)


@dataclass(frozen=True)
class OfJoints(SmoothFunction):
    """A smooth function of one joint's angle, or of two together (without what either does alone); of no orders it is a mean."""

    of: tuple[int, ...] = (0,)
    orders: int = ORDERS

    @property
    def inputs(self) -> tuple[str, ...]:
        """The joints it depends on."""
        return tuple(f"q{i + 1}" for i in self.of)

    @property
    def spectrum(self) -> np.ndarray:
        """Waves that fall with their order, along each direction."""
        return np.tile(self._sizes, len(self.declared) // len(self._sizes))

    @property
    def _sizes(self) -> np.ndarray:
        """The waves' sizes beside each other, those of `waves`."""
        if not self.orders:
            return np.ones(1)
        return np.repeat(1 / np.arange(1.0, self.orders + 1), 2) if len(self.of) == 1 else np.ones(4)

    def waves(self, q: ca.SX) -> ca.SX:
        """Return waves (n,) of one joint's angle, or products of two joints'; of a slide half a turn is its travel."""
        if not self.orders:
            return ca.SX(1.0)
        turn = turn_of_readings(self.robot)
        first, *second = (q[i] * float(turn[i]) for i in self.of)
        if second:
            return ca.vec(_phases(second[0]) @ _phases(first).T)
        return ca.vec(_phases(first @ ca.DM(range(1, self.orders + 1)).T))


@dataclass(frozen=True)
class JointField(OfJoints, JointError):
    """The errors of some joints (their numbers, from 0, in order; all where there are none) as such functions."""

    erring: tuple[int, ...] = ()

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the waves."""
        waves = ca.vertsplit(self.waves(state.q)) if joint in self._erring else []
        return [Term(f"wave{k + 1}", self.unit(joint), SIZE, 1.0, value) for k, value in enumerate(waves)]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn the joints by the same waves."""
        waves, turned = self.waves(state.q), ca.SX(self.robot.n_joints, 1)
        turned[list(self._erring)] = ca.reshape(p, waves.numel(), len(self._erring)).T @ waves
        return replace(still, joint=turned)

    @property
    def _erring(self) -> Sequence[int]:
        return self.erring or range(self.robot.n_joints)


@dataclass(frozen=True)
class Shift(OfJoints):
    """A shift of the reported point as such a function."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the waves along each axis."""
        n = len(self._sizes)
        return self.amplitudes("point", (f"wave{k + 1}{axis}" for axis in "xyz" for k in range(n)))

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        return point + ca.reshape(p, p.numel() // 3, 3).T @ self.waves(row.q)


@dataclass(frozen=True)
class Field(SmoothFunction):
    """A shift of the whole arm by the angles of some joints together, alike over a length a joint, in its readings' unit.

    Of several arms it is one of the reported point, since a base that they share shifts nothing that one sees of another. Its waves
    are of the frequencies of a squared exponential process (Rahimi and Recht 2007), spread evenly (Owen 1998).
    """

    of: tuple[int, ...]
    lengths: tuple[float, ...]
    n_waves: int = 128  # of any phase

    @property
    def inputs(self) -> tuple[str, ...]:
        """The joints' angles, together."""
        return ("joints",)

    @property
    def spectrum(self) -> np.ndarray:
        """All alike: together they are as large as one function by which a part is sized."""
        return np.full(len(self.declared), (USUAL * self.n_waves) ** -0.5)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return cosines, then sines, along each axis."""
        n = 2 * self.n_waves
        return self.amplitudes("arm", (f"wave{k + 1}{axis}" for axis in "xyz" for k in range(n)))

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Shift the arm, if there is only one."""
        if len(self.robot.tips) > 1:
            return still
        link = ca.SX(still.link)
        link[:3, 0] = self._shift(p, state.q)
        return replace(still, link=link)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported of several arms."""
        return point + self._shift(p, row.q) if len(self.robot.tips) > 1 else point

    def _shift(self, p: ca.SX, q: ca.SX) -> ca.SX:
        even = scipy.stats.qmc.Sobol(len(self.of), seed=1).random(self.n_waves)
        angle = ca.DM(scipy.stats.norm.ppf(even) / self.lengths) @ q[list(self.of)]
        return ca.reshape(p, p.numel() // 3, 3).T @ ca.vertcat(ca.cos(angle), ca.sin(angle))


@dataclass(frozen=True)
class Oscillation(SmoothFunction):
    """A shift of the reported point that comes and goes with time."""

    rate: float = 1.0  # rad/s

    @property
    def inputs(self) -> tuple[str, ...]:
        """Time."""
        return ("time",)

    @property
    def detail(self) -> str:
        """Say the period."""
        return f"period {2 * np.pi / self.rate:.3g} s"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return both phases along each axis."""
        return self.amplitudes("device", (f"{phase}{axis}" for phase in ("cos", "sin") for axis in "xyz"))

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        angle = self.rate * row.time
        return point + p[:3] * ca.cos(angle) + p[3:] * ca.sin(angle) if row.time.nnz() else point


class DeviceShift(SmoothFunction):
    """A shift of what the device reports."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return it along each axis."""
        return self.amplitudes("device", "xyz")

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift it."""
        return point + p


class LinkLengths(SmoothFunction):
    """By how much all links are longer."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return it."""
        return self.amplitudes("links", ("growth",), "1", GROWTH_SD)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Lengthen them."""
        return grown(self.robot, dims, 1 + p)


class JointZeros(JointError):
    """By how much the joints' zeros are off."""

    id, title = SmoothFunction.id, SmoothFunction.title

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the zero."""
        return [Term("zero", self.unit(joint), SIZE, 1.0, ca.SX(1))]


# What may walk in time, of the device and of the robot: where all of it acts that does not change.
WALKING: dict[str, type[Effect]] = {
    "shift": DeviceShift, "scale": TrackerScale, "lengths": LinkLengths, "zeros": JointZeros,
}  # fmt: skip


@dataclass(frozen=True)
class Wandering(SmoothFunction):
    """A part of how something wanders with time, of so many times the usual size: see `WALKING`."""

    of: str = "shift"
    clock: Literal["time", "order"] = "time"
    begin: float = 0.0
    end: float = 1.0
    share: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """Time, or the order of the rows."""
        return (self.clock,)

    @property
    def spectrum(self) -> np.ndarray:
        """All alike: a whole walk is as large as one function by which a part is sized."""
        return np.full(len(self.declared), USUAL**-0.5)

    @cached_property
    def quantity(self) -> Effect:
        """What wanders, as if it did not."""
        return WALKING[self.of](self.robot)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return by how much, in all."""
        return tuple(
            replace(figure, effect=self.id, prior_sd=self.share * figure.prior_sd)
            for figure in self.quantity.parameters()
        )

    def gone(self, row: Row) -> ca.SX:
        """Return how much of it has come about; structurally zero where a row does not tell."""
        raise NotImplementedError

    @property
    def gives_way(self) -> bool:
        """Whether what wanders does."""
        return self.quantity.gives_way

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Change what is reported."""
        return self.quantity.device(p * self.gone(row), point, row)

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Change lengths."""
        return self.quantity.dimensions(p * self.gone(row), dims, row)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn joints."""
        return self.quantity.deflection(p * self.gone(row), state, row, still)


@dataclass(frozen=True)
class InTime(Wandering):
    """A step of a random walk, evenly from a begin to an end; mean is how much has gone on average over the measurement.

    What stays is the base's.
    """

    mean: float = 0.0

    def gone(self, row: Row) -> ca.SX:
        """Return the share that has gone, about its average."""
        at = row.time if self.clock == "time" else row.order
        gone = ca.fmax(0, ca.fmin(1, (at - self.begin) / (self.end - self.begin)))
        return gone - self.mean if at.nnz() else ca.SX(1, 1)


@dataclass(frozen=True)
class Later(Wandering):
    """How a walk goes on after its end, and before its begin: as far in as long again as was measured.

    A robot's ends: it is cold, or as warm as it gets.
    """

    def gone(self, row: Row) -> ca.SX:
        """Return the root of the time there, over that of the measurement."""
        if not row.time.nnz():
            return ca.SX(1, 1)
        beyond = ca.fmax(0, ca.fmax(self.begin - row.time, row.time - self.end))
        most = np.inf if self.quantity.of_device() else SETTLED
        return ca.sqrt(ca.fmin(beyond, most) / ((self.end - self.begin) or 1.0))


@dataclass(frozen=True)
class AtAnyTime(Wandering):
    """What it is where a row's time is not known."""

    def gone(self, row: Row) -> ca.SX:
        """Return all of it there."""
        return ca.SX(1, 1) if row.time.nnz() else ca.SX(1)


@dataclass(frozen=True)
class BeyondTravel(JointError, SmoothFunction):
    """A joint's error where its curve was not measured, beyond low and high: another one of its kind, of a size [rad].

    Its waves are of the frequencies by which a Matern 5/2 process is alike over a length [rad]: those of a Student t.
    """

    joint: int = 0
    low: float = 0.0
    high: float = 0.0
    length: float = 1.0
    size_beyond: float = SIZE

    @property
    def inputs(self) -> tuple[str, ...]:
        """The joint."""
        return (f"q{self.joint + 1}",)

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return waves that are full a twentieth of the travel beyond its ends, where a measured curve fades."""
        if joint != self.joint:
            return []
        q, size = state.q[joint], self.size_beyond / BEYOND_WAVES**0.5
        beyond = ca.fmax(self.low - q, 0) + ca.fmax(q - self.high, 0)
        value = ca.fmin(beyond / (FADE * (self.high - self.low)), 1)
        rates = scipy.stats.t(5).ppf((1 + np.arange(0.5, BEYOND_WAVES) / BEYOND_WAVES) / 2) / self.length
        angle = ca.DM(rates) * q
        waves = ca.vertsplit(value * ca.vertcat(ca.cos(angle), ca.sin(angle)))
        return [Term(f"wave{k + 1}", self.unit(joint), size, 1.0, wave) for k, wave in enumerate(waves)]


@dataclass(frozen=True)
class UnderPayload(SmoothFunction):
    """Under one payload: zeros of all joints, a wave of each, the marker on the tool and the device's place, which are others."""

    payload: str = ""

    @property
    def inputs(self) -> tuple[str, ...]:
        """The payload."""
        return ("payload",)

    @property
    def detail(self) -> str:
        """Say which."""
        return f"under {self.payload}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return offset and wave of each joint, and the shifts of marker and device."""
        symbols = [(f"{term}{i + 1}", joint.unit) for i, joint in enumerate(self.robot.joints)
                   for term in ("offset", "cos", "sin")]  # fmt: skip
        symbols += [(f"{whose}{axis}", "m") for whose in ("marker", "device") for axis in "xyz"]
        return tuple(Parameter(self.id, "payload", symbol, unit, SIZE, -1.0, 1.0) for symbol, unit in symbols)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn the joints, and shift the flange with what it carries."""
        on, n = self._carried(row), self.robot.n_joints
        waves = [ca.vertcat(1, ca.cos(state.q[i]), ca.sin(state.q[i])) for i in range(n)]
        turned = [on * ca.dot(p[3 * i : 3 * i + 3], wave) for i, wave in enumerate(waves)]
        link = ca.SX(still.link)
        link[:3, -1] = on * p[3 * n : 3 * n + 3]
        return replace(still, joint=ca.vertcat(*turned), link=link)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        return point + self._carried(row) * p[-3:]

    def _carried(self, row: Row) -> ca.SX:
        return row.payload[list(self.robot.payloads).index(self.payload)]


@dataclass(frozen=True)
class InPlace(SmoothFunction):
    """A shift of the reported point that depends smoothly on where it is."""

    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    reach: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The place."""
        return "x", "y", "z"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the cubic terms along each axis; lower ones are geometry's."""
        return self.amplitudes("place", (f"{axis}{k}" for axis in "xyz" for k in range(len(_powers()))))

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        near = (point - ca.DM(self.centre)) / self.reach
        terms = ca.vertcat(*(near[0] ** i * near[1] ** j * near[2] ** k for i, j, k in _powers()))
        return point + ca.reshape(p, len(_powers()), 3).T @ terms


@dataclass(frozen=True)
class InImage(SmoothFunction):
    """A shift of a seen point across its line of sight, by where in the image it is shown: what the lens is beside its model."""

    of_images = True

    @property
    def inputs(self) -> tuple[str, ...]:
        """The place in the image."""
        return ("image",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the terms up to cubic ones along both axes."""
        terms = (f"{axis}{k}" for axis in "xy" for k in range(len(_IN_IMAGE)))
        return self.amplitudes("lens", terms, "1", LENS_SIZE)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Turn the line of sight."""
        u, v = (point[axis] / (SIGHT * point[2]) for axis in (0, 1))
        terms = ca.vertcat(*(u**i * v**j for i, j in _IN_IMAGE))
        return point + point[2] * ca.vertcat(ca.reshape(p, len(_IN_IMAGE), 2).T @ terms, 0)


_IN_IMAGE = [(i, j) for i in range(4) for j in range(4) if i + j <= 3]


@dataclass(frozen=True)
class OnTarget(SmoothFunction):
    """A target that is stretched, skewed or bowed: the print's points beside where they are said to be."""

    of_images = True

    @property
    def inputs(self) -> tuple[str, ...]:
        """The place on the target."""
        return ("target",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return stretches along x and y, skew, and heights of a quadric."""
        return self.amplitudes("target", ("stretch x", "stretch y", "skew", "height xx", "height xy", "height yy"))

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Move the point."""
        x, y = point[0] / REACH, point[1] / REACH
        return point + ca.vertcat(p[0] * x + p[2] * y, p[1] * y + p[2] * x, bow(p[3:], point))


SMOOTH_ORDERS = 4  # of a joint's angle
TINY = 1e-6  # m, of a travel
STILL = 1e-9  # of the largest slope by a joint: what is less is rounding
FADE = 0.05  # of a measured travel, beyond which its curve tells nothing
BEYOND_WAVES = 8  # of a curve beyond its travel, each of any phase
# Of a random walk in the course of the measurement, each of as many rows, and pauses besides; a robot warms up steadily.
STEPS, STEPS_OF_ROBOT = 16, 4
SETTLED = 2 * WARM_UPS[-1]  # s, after which a robot is as warm as it gets
WALK = 6**0.5  # by how much such a walk gets on, over its root mean square about its mean


def smooth_functions(
    problem: LeastSquares, estimate: np.ndarray, data: Measurements
) -> list[tuple[tuple[str, ...], list[SmoothFunction]]]:
    """Return inputs and functions of what may be left: of each joint, two together, place, payload, and time or order.

    Of images the place is that in the image, and that on the target.

    By a joint's angle, that joint may err, the others, and the point: three parts, since none tells how large another is. So it
    is by two joints'. Joints that no residual depends on together, as those of two arms, have none of each other.
    """
    robot, groups = data.robot, moved_together(problem, estimate)
    bases: list[tuple[tuple[str, ...], list[SmoothFunction]]] = []
    for i in sorted(set().union(*groups)):
        others = tuple(k for k in _beside(groups, i) if k != i)
        fields = [JointField(robot, (i,), SMOOTH_ORDERS, erring) for erring in ((i,), others) if erring]
        bases += [((f"q{i + 1}",), [function]) for function in (*fields, Shift(robot, (i,), SMOOTH_ORDERS))]
    if pairs := pairs_of(groups):
        fields = [JointField(robot, pair, erring=_beside(groups, *pair)) for pair in pairs]
        bases += [(("joints",), [*fields]), (("joints",), [Shift(robot, pair) for pair in pairs])]
    if not of_images(data):
        bases += [(place.inputs, [place]) for place in of_place(problem.model, estimate, data)]
    walks = (in_time(data, of) for of in WALKING if of != Wandering.of)
    return bases + beside_joints(data) + [(walk[0].inputs, [*walk]) for walk in walks if walk]


def means(functions: Sequence[SmoothFunction]) -> list[SmoothFunction]:
    """Return the means of what joints err by: a joint's zero is as unsure as such functions have one."""
    return [replace(of, orders=0) for of in functions if isinstance(of, JointField)]


def is_mean(function: SmoothFunction) -> bool:
    """Return whether a function is such a mean."""
    return isinstance(function, OfJoints) and not function.orders


def beside_joints(data: Measurements) -> list[tuple[tuple[str, ...], list[SmoothFunction]]]:
    """Return inputs and functions of what may be left by the place in an image and on a target, by payload, and time or order."""
    bases: list[tuple[tuple[str, ...], list[SmoothFunction]]] = [(of.inputs, [of]) for of in of_images(data)]
    if loaded := under_payloads(data):
        bases.append((("payload",), [*loaded]))
    if steps := in_time(data):
        bases.append((steps[0].inputs, [*steps]))
    return bases


def moved_together(problem: LeastSquares, estimate: np.ndarray) -> list[frozenset[int]]:
    """Return the groups of joints (from 0) that a residual depends on, with those before them in their chains."""
    robot = problem.model.robot
    if len(robot.tips) == 1:
        return [frozenset(range(robot.n_joints))]
    n = len(estimate)
    slopes = probed(problem, estimate, [JointField(robot, (0,), 1)])[1][:, n:].reshape(-1, robot.n_joints, 2)
    moved = np.unique(np.abs(slopes).max(axis=2) > STILL * np.abs(slopes).max(), axis=0)
    chains = [frozenset(robot.chain(link)) for link in range(1, robot.n_joints + 1)]
    return [frozenset().union(*(chains[i] for i in np.flatnonzero(row))) for row in moved]


def pairs_of(groups: Sequence[frozenset[int]]) -> list[tuple[int, int]]:
    """Return every two joints that are of one group."""
    return sorted({pair for group in groups for pair in combinations(sorted(group), 2)})


def _beside(groups: Sequence[frozenset[int]], *joints: int) -> tuple[int, ...]:
    """Return the joints of all groups that some joints are in, in order."""
    return tuple(sorted(set().union(*(group for group in groups if group.issuperset(joints)))))


def in_time(data: Measurements, of: str = Wandering.of) -> list[InTime]:
    """Return how a quantity may wander with time, or with the order of the rows where no time is known."""
    clock: Literal["time", "order"] = "time" if "time" in data.given else "order"
    if clock not in data.given:
        return []
    at = data.table[clock].to_numpy(float)
    n, every = STEPS if WALKING[of].of_device() else STEPS_OF_ROBOT, np.unique(at)
    paused = np.flatnonzero(np.diff(every) > np.ptp(at) / n)
    nodes = np.unique(
        [*np.quantile(at, np.linspace(0, 1, n + 1), method="nearest"), *every[paused], *every[paused + 1]]
    )
    return [
        InTime(data.robot, of, clock, begin, end, WALK * ((end - begin) / np.ptp(at)) ** 0.5,
               float(np.clip((at - begin) / (end - begin), 0, 1).mean()))
        for begin, end in pairwise(nodes.tolist())
    ]  # fmt: skip


def under_payloads(data: Measurements) -> list[UnderPayload]:
    """Return what may differ from payload to payload."""
    carried = list(dict.fromkeys(data.table["payload"]))  # what differs from one of them differs from the first, too
    return [UnderPayload(data.robot, name) for name in carried[1 if all(carried) else 0 :] if name]


def of_place(model: Model, estimate: np.ndarray, data: Measurements) -> list[SmoothFunction]:
    """Return the smooth functions of place where a model's rows are, or of images of a target."""
    if images := of_images(data):
        return images
    place = model.point(estimate, data.conditions)
    centre = place.mean(axis=0)
    return [InPlace(data.robot, tuple(map(float, centre)), float(np.abs(place - centre).max()) or 1.0)]


def of_images(data: Measurements) -> list[SmoothFunction]:
    """Return those of images of a target's points, by which lens and print show."""
    seen = data.in_images and "px_x" in data.table
    return [InImage(data.robot), OnTarget(data.robot)] if seen else []


def turn_of_readings(robot: Robot) -> np.ndarray:
    """Return what makes angles of joint readings, shape (n_joints,): 1, of slides half a turn over their travel [rad/m]."""
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    return np.where(slides, np.pi / np.maximum(np.ptp(robot.limits, axis=1), TINY), 1.0)


def _phases(angles: ca.SX) -> ca.SX:
    """Return cosines and sines (2, n) of angles (1, n)."""
    return ca.vertcat(ca.cos(angles), ca.sin(angles))


def _powers() -> list[tuple[int, int, int]]:
    return [(i, j, k) for i in range(4) for j in range(4) for k in range(4) if 2 <= i + j + k <= 3]
