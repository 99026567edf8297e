"""Frames: the elementary transforms that a chain is made of, and the ways in which they are stated.

By the figures of a convention, or by a place and a turn in full, as URDF does; as numbers, or as CasADi expressions (4, 4).
Lengths in m, angles in rad.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Literal, Protocol

import casadi as ca
import numpy as np

from calflow.files.deferred import Rotation

Vector = tuple[float, float, float]
Motion = Literal["rx", "ry", "rz", "tx", "ty", "tz"]
Place = Literal["first", "middle", "last", "alone"]

PARALLEL = 0.1  # axes within this angle [rad] count as nearly parallel: their distance along z is not defined
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
SHIFTS: tuple[Motion, ...] = ("tx", "ty", "tz")
TURNS: tuple[Motion, ...] = ("rx", "ry", "rz")
BEYOND: tuple[Place, ...] = ("middle", "last")
STARTING: tuple[Place, ...] = ("first", "alone")
STANDS = ("x", "y", "z", "rx", "ry", "rz")
LISTED = ("x", "y", "z", "rx", "ry", "rz", "theta")
ZEROS_WEIGHT = 10.0  # how much rather a joint's zero is kept: where axes are parallel, from 0.1 m between them on
NO_TURN = 1e-12  # rad


@dataclass(frozen=True)
class Step:
    """One elementary transform: a turn about an axis or a shift along it, by value [rad or m].

    free says at which places of the chain an error of the value is a parameter of its own: it is not where another figure
    moves the tool in exactly the same way whatever the pose.
    """

    motion: Motion
    symbol: str
    value: float = 0.0
    free: tuple[Place, ...] = ()

    @property
    def is_length(self) -> bool:
        """Whether its value is a length [m]."""
        return self.motion[0] == "t"

    @property
    def unit(self) -> str:
        """Its value's unit."""
        return "m" if self.is_length else "rad"

    @property
    def shown(self) -> tuple[Literal["mm", "deg"], float]:
        """The unit in which people read its value, and the value in it."""
        return ("mm", 1e3 * self.value) if self.is_length else ("deg", float(np.rad2deg(self.value)))


@dataclass(frozen=True)
class Frame:
    """The way from the link that a joint is on to the joint's own link.

    origin leads from a link that others go on from to where the joint stands beside them; reach leads along the link before to
    that link's end, which then gives way (the base, and a link with several joints on it, give way before); mount leads from
    there to the joint's axis; turn is about that axis, and a revolute joint's variable is added to it, whereupon the bearing
    gives way; body leads from the axis to the link's own frame, and a prismatic joint's variable is added to its first shift
    along z. listed orders the symbols as tables do; those not in it follow as they come.
    """

    turn: Step
    reach: tuple[Step, ...] = ()
    mount: tuple[Step, ...] = ()
    body: tuple[Step, ...] = ()
    listed: tuple[str, ...] = ()
    origin: tuple[Step, ...] = ()

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """All steps, in the order in which they are taken."""
        return (*self.origin, *self.reach, *self.mount, self.turn, *self.body)

    def step(self, symbol: str) -> Step:
        """Return the step with a symbol; KeyError where there is none."""
        return {step.symbol: step for step in self.steps}[symbol]

    @property
    def figures(self) -> dict[str, float]:
        """Each step's value by its symbol."""
        return {step.symbol: step.value for step in self.steps}

    def restated(self, figures: Mapping[str, float]) -> Frame:
        """Return the frame with other values of steps, by symbol; which are free follows where it is of a convention."""

        def steps(several: tuple[Step, ...]) -> tuple[Step, ...]:
            return tuple(replace(step, value=figures.get(step.symbol, step.value)) for step in several)

        if convention := convention_of([self]):
            again = CONVENTIONS[convention](**replace(self, origin=()).figures | dict(figures))
            return replace(again, origin=self.origin)
        (turn,) = steps((self.turn,))
        return replace(self, origin=steps(self.origin), reach=steps(self.reach), mount=steps(self.mount), turn=turn,
                       body=steps(self.body))  # fmt: skip

    def free(self, place: Place) -> tuple[Step, ...]:
        """Return the steps whose errors are parameters of their own at a place of the chain, as tables list them."""
        return tuple(step for step in self.every if place in step.free)

    @property
    def every(self) -> tuple[Step, ...]:
        """All steps as tables list them."""
        order = {symbol: k for k, symbol in enumerate(self.listed)}
        return tuple(sorted(self.steps, key=lambda step: order.get(step.symbol, len(order))))

    @property
    def slide(self) -> Step | None:
        """The step that a prismatic joint's variable is added to, if there is one."""
        return next((step for step in self.body if step.motion == "tz"), None)


class Convention(Protocol):
    """A way to state a frame by five figures [rad and m]."""

    def __call__(
        self, *, alpha: float = ..., a: float = ..., d: float = ..., theta: float = ..., beta: float = ...
    ) -> Frame: ...


def dh(*, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0, beta: float = 0.0) -> Frame:
    """Return the frame Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) of Denavit and Hartenberg (1955).

    The first joint's theta and d are the base's. Where the next axis is nearly parallel, d along it is replaced by beta
    (Hayati 1983); the last link's d is kept, its a, alpha and beta are the tool's.
    """
    parallel = _parallel(alpha)
    return Frame(
        turn=Step("rz", "theta", float(theta), ("middle", "last")),
        body=(
            Step("tz", "d", float(d), ("last",) if parallel else ("middle", "last")),
            Step("tx", "a", float(a), ("first", "middle")),
            Step("rx", "alpha", float(alpha), ("first", "middle")),
            Step("ry", "beta", float(beta), ("first", "middle") if parallel else ()),
        ),
        listed=("theta", "d", "beta", "a", "alpha"),
    )


def modified_dh(*, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0, beta: float = 0.0) -> Frame:
    """Return the frame Tx(a) Rx(alpha) Ry(beta) Rz(theta + q) Tz(d) of Craig (1986).

    The first joint's figures are all the base's. Where the axis before is nearly parallel, d is replaced by beta (Hayati
    1983; equations 1 and 6 of the HH800 paper).
    """
    beyond: tuple[Place, ...] = ("middle", "last")
    parallel = _parallel(alpha)
    return Frame(
        reach=(Step("tx", "a", float(a), beyond),),
        mount=(Step("rx", "alpha", float(alpha), beyond), Step("ry", "beta", float(beta), beyond if parallel else ())),
        turn=Step("rz", "theta", float(theta), beyond),
        body=(Step("tz", "d", float(d), () if parallel else beyond),),
        listed=("alpha", "a", "beta", "d", "theta"),
    )


CONVENTIONS: Mapping[str, Convention] = {"dh": dh, "modified-dh": modified_dh}


def at_origin(
    frame: Frame, origin: Sequence[float] = (0.0, 0.0, 0.0), rotation: Sequence[float] = (0.0, 0.0, 0.0)
) -> Frame:
    """Return a frame whose first joint stands at an origin [m, and rad about x, y and z in turn] of a link beside other joints.

    As a base does in the measuring frame, it has errors in all six.
    """
    figures = zip((*SHIFTS, *TURNS), STANDS, (*origin, *rotation), strict=True)
    return replace(
        frame, origin=tuple(Step(motion, symbol, float(value), STARTING) for motion, symbol, value in figures)
    )


def follows(frame: Frame, convention: str) -> bool:
    """Return whether a frame is what a convention makes of its figures, wherever it stands."""
    bare = replace(frame, origin=())
    figures = bare.figures
    return set(figures) == {"alpha", "a", "d", "theta", "beta"} and bare == CONVENTIONS[convention](**figures)


def convention_of(frames: Sequence[Frame]) -> str | None:
    """Return the convention that all frames follow; None where there is no such."""
    return next((name for name in CONVENTIONS if all(follows(frame, name) for frame in frames)), None)


def kinematics(frames: Sequence[Frame]) -> str:
    """Say what frames follow: a convention's name, or `frames of its own`."""
    return convention_of(frames) or "frames of its own"


def _parallel(alpha: float) -> bool:
    return bool(abs(np.sin(alpha)) < PARALLEL)


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a part holds them."""
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class FrameOrigin:
    """Where a frame stands in another: shifted by xyz [m], then turned by rpy [rad] about its fixed x, y and z in turn."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> np.ndarray:
        """The turn as a matrix (3, 3)."""
        roll, pitch, yaw = self.rpy
        return about(2, yaw) @ about(1, pitch) @ about(0, roll)

    def at(self, point: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return a point (3,) of the frame as the other frame sees it."""
        return np.array(self.xyz) + self.rotation @ np.array(point)

    @property
    def inverse(self) -> FrameOrigin:
        """Where the frame in which it stands is, seen from its own."""
        if self == FrameOrigin():
            return self
        x, y, z = map(float, -self.rotation.T @ np.array(self.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation.T))

    def then(self, inner: FrameOrigin) -> FrameOrigin:
        """Return the origin of a frame that stands in this one."""
        if self == FrameOrigin():
            return inner
        if inner == FrameOrigin():
            return self
        x, y, z = map(float, self.at(inner.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation @ inner.rotation))


def about(axis: int, angle: float) -> np.ndarray:
    """Return the turn (3, 3) about an axis (0: x, 1: y, 2: z)."""
    matrix, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j] = -matrix[j, i]
    return matrix


def rpy_of(rotation: np.ndarray) -> Vector:
    """Return the turns about fixed x, y and z in turn [rad] that make up a rotation (3, 3)."""
    across = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = float(np.arctan2(-rotation[2, 0], across))
    # Near a right angle x and z turn about nearly the same line: x takes what rounding leaves of z, and at one all of it.
    yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0])) if across > NO_TURN else 0.0
    y = np.cos(yaw) * rotation[1] - np.sin(yaw) * rotation[0]
    return float(np.arctan2(-y[2], y[1])), pitch, yaw


@dataclass(frozen=True)
class Axis:
    """A joint's axis: its direction in the joint's own frame, of length 1, and whether it is turned about or slid along."""

    direction: Vector
    slides: bool = False

    @property
    def nearest(self) -> int:
        """The coordinate axis (0 to 2) that it is nearest to."""
        return int(np.argmax(np.abs(self.direction)))

    @property
    def turns(self) -> tuple[float, float]:
        """The turns about z and then y [rad] that lead from z to it."""
        x, y, z = self.direction
        across = np.hypot(x, y)
        around = float(np.arctan2(y, x)) if across > NO_TURN else 0.0
        return around, float(np.arctan2(across, z)) if across > NO_TURN else (0.0 if z > 0 else np.pi)


def joint_frame(
    origin: FrameOrigin,
    axis: Axis,
    before: Axis | None,
    zero: float = 0.0,
    tip: FrameOrigin | None = None,
    beside: bool = False,
) -> Frame:
    """Return the frame of a joint that stands at an origin in the link before, and whose own axes its link has.

    before is the axis of the joint before, None for the first joint; beside says that the joint stands on its link beside one
    that goes on from it, which alone makes up for motions of the link; zero [rad or m] is added to the joint's variable; tip is
    the flange in the frame of a joint that no other is on. Parameters are x, y, z (its place), two turns about coordinate axes
    that tilt the axis, and the joint's zero, without those that the others do whatever the pose (see `left_out`).
    """
    around, tilt = axis.turns
    free = {*AXES, *_tilts(axis), "theta"} if beside else _free(origin, axis, before)

    def figure(motion: Motion, symbol: str, value: float = 0.0) -> Step:
        return Step(motion, symbol, float(value), (STARTING if beside else BEYOND) if symbol in free else ())

    aligned = (Step("rz", "around", around), Step("ry", "tilt", tilt))
    back = (Step("ry", "tilt_back", -tilt), Step("rz", "around_back", -around))
    roll, pitch, yaw = origin.rpy
    return Frame(
        reach=tuple(figure(SHIFTS[k], AXES[k], origin.xyz[k]) for k in range(3)),
        mount=(
            *_stated(Step("rz", "yaw", yaw), Step("ry", "pitch", pitch), Step("rx", "roll", roll)),
            *(figure(turn, turn) for turn in _tilts(axis)),
            *_stated(*aligned),
        ),
        turn=figure("rz", "theta", 0.0 if axis.slides else zero),
        body=(*((Step("tz", "s", zero),) if axis.slides else ()), *_stated(*back), *_to_tip(tip)),
        listed=LISTED,
    )


def origins_left_out(frame: Frame) -> tuple[str, ...]:
    """Return the figures of an origin's frame that are no parameters, since others do the same whatever the pose."""
    return tuple(step.symbol for step in frame.steps if step.symbol in LISTED and not step.free)


def _tilts(axis: Axis) -> tuple[Motion, ...]:
    """The two turns that tilt an axis: about the coordinate axes that it is not near to."""
    return tuple(turn for k, turn in enumerate(TURNS) if k != axis.nearest)


def _stated(*steps: Step) -> tuple[Step, ...]:
    """The steps that lead anywhere."""
    return tuple(step for step in steps if step.value)


def _to_tip(tip: FrameOrigin | None) -> tuple[Step, ...]:
    if tip is None:
        return ()
    (x, y, z), (roll, pitch, yaw) = tip.xyz, tip.rpy
    return _stated(
        Step("tx", "tip_x", x), Step("ty", "tip_y", y), Step("tz", "tip_z", z),
        Step("rz", "tip_yaw", yaw), Step("ry", "tip_pitch", pitch), Step("rx", "tip_roll", roll),
    )  # fmt: skip


def _free(origin: FrameOrigin, axis: Axis, before: Axis | None) -> frozenset[str]:
    """The figures whose errors are parameters of their own.

    What moves the joint along or about the axis before moves that joint's own frame and is counted there (of a slide every shift
    and the turn about it). The others kept are those that, with these motions, span all small motions best.
    """
    if before is None:
        return frozenset()  # the base has them
    turning, place = origin.rotation, np.array(origin.xyz)
    lines: dict[str, np.ndarray] = {turn: turning[:, TURNS.index(turn)] for turn in _tilts(axis)}
    lines["theta"] = turning @ np.array(axis.direction)
    twists: dict[str, np.ndarray] = {AXES[k]: np.concatenate([np.eye(3)[k], np.zeros(3)]) for k in range(3)}
    twists |= {name: np.concatenate([np.cross(place, line), line]) for name, line in lines.items()}
    shifts = np.eye(3) if before.slides else np.array([before.direction])
    same = [np.concatenate([shift, np.zeros(3)]) for shift in shifts]
    same.append(np.concatenate([np.zeros(3), before.direction]))

    def worth(kept: tuple[str, ...]) -> float:
        spanned = abs(float(np.linalg.det(np.array([*same, *(twists[name] for name in kept)]))))
        return round(spanned * (ZEROS_WEIGHT if "theta" in kept else 1.0), 6)

    best = max(combinations(twists, 6 - len(same)), key=worth)
    return frozenset(best)


Scalar = ca.SX | ca.DM | float


def _rotation(axis: int, angle: Scalar) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    matrix = ca.SX.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def translation(x: Scalar, y: Scalar, z: Scalar) -> ca.SX:
    """Translation by (x, y, z)."""
    matrix = ca.SX.eye(4)
    matrix[0, 3], matrix[1, 3], matrix[2, 3] = x, y, z
    return matrix


def elementary(motion: Motion, value: Scalar) -> ca.SX:
    """Turn about an axis, or shift along it."""
    kind, axis = motion
    if kind == "r":
        return _rotation("xyz".index(axis), value)
    return translation(*(value if axis == other else 0 for other in "xyz"))


@lru_cache
def moving(motion: Motion) -> ca.Function:
    """Return the function (value, point) -> point turned or shifted: to call it takes a third of what building it takes."""
    value, point = ca.SX.sym("value"), ca.SX.sym("point", 3)
    return ca.Function("moved", [value, point], [apply(elementary(motion, value), point)])


def placement(v: ca.SX | ca.DM) -> ca.SX:
    """Translation by v[0:3], then rotations about x, y and z by v[3:6], each about the axis already turned."""
    return translation(v[0], v[1], v[2]) @ _rotation(0, v[3]) @ _rotation(1, v[4]) @ _rotation(2, v[5])


def placement_matrix(six: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the transform (4, 4) of a shift [m] and turns about x, y and z in turn [rad], as numbers."""
    return np.array(ca.DM(ca.evalf(placement(ca.DM(list(map(float, six)))))))


def turning(rotation: ca.SX, by: ca.SX) -> ca.SX:
    """Return how a rotation (3, 3) turns about its own axes by each symbol, shape (3, n) [rad per unit]."""
    x, y, z = (rotation[:, k] for k in range(3))
    slope = ca.jacobian(ca.vec(rotation), by)
    return ca.vertcat(z.T @ slope[3:6, :], x.T @ slope[6:, :], y.T @ slope[:3, :])


def apply(transform: ca.SX, point: ca.SX) -> ca.SX:
    """Return the point (3,) moved by the transform."""
    return transform[:3, :3] @ point + transform[:3, 3]


def angles(turn: Rotation, order: str = "XYZ") -> np.ndarray:
    """Return the turns [rad] that make up a rotation, about axes in an order that is named as SciPy does.

    Where the middle one is a right angle the other two turn about the same line: then all of that is said by the first.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # which is said above, and no trouble: tools often stand so
        return np.asarray(turn.as_euler(order))
