"""Frames: the elementary transforms of a kinematic chain, and the conventions that state them.

A frame follows from Denavit-Hartenberg parameters, or from a full position and orientation as in URDF. Transforms are
numbers or CasADi expressions (4, 4); lengths in m, angles in rad.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Literal

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
ZEROS_WEIGHT = 10.0  # preference for keeping a joint's zero as parameter: for parallel axes, from 0.1 m apart on
NO_TURN = 1e-12  # rad


@dataclass(frozen=True)
class Step:
    """An elementary transform: a rotation about an axis or a translation along it, by value [rad or m].

    free: the places in a chain at which an error of the value is an independent parameter; elsewhere another parameter
    moves the tool in exactly the same way at every pose.
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
        """The display unit of its value, and the value in that unit."""
        return ("mm", 1e3 * self.value) if self.is_length else ("deg", float(np.rad2deg(self.value)))


@dataclass(frozen=True)
class Frame:
    """The transform from a joint's parent link to the joint's own link, in five groups of steps.

    origin: from a link with several joints to where this joint stands; reach: along the parent link to its end, where
    the link's deflection acts (before reach for the base and for a link with several joints); mount: to the joint's
    axis;
    turn: about that axis, plus a revolute joint's variable, after which the bearing's deflection acts; body: from the
    axis to the link's frame, where a prismatic joint's variable is added to the first translation along z. listed: the
    order of symbols in tables; others follow.
    """

    turn: Step
    reach: tuple[Step, ...] = ()
    mount: tuple[Step, ...] = ()
    body: tuple[Step, ...] = ()
    listed: tuple[str, ...] = ()
    origin: tuple[Step, ...] = ()

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """All steps, in kinematic order."""
        return (*self.origin, *self.reach, *self.mount, self.turn, *self.body)

    def step(self, symbol: str) -> Step:
        """Return the step with a symbol; KeyError if there is none."""
        return {step.symbol: step for step in self.steps}[symbol]

    @property
    def figures(self) -> dict[str, float]:
        """Each step's value by its symbol."""
        return {step.symbol: step.value for step in self.steps}

    def restated(self, figures: Mapping[str, float]) -> Frame:
        """Return the frame with new values of steps, by symbol; a convention's frame updates which are free."""

        def steps(several: tuple[Step, ...]) -> tuple[Step, ...]:
            return tuple(replace(step, value=figures.get(step.symbol, step.value)) for step in several)

        if convention := convention_of([self]):
            own = {symbol: figures.get(symbol, value) for symbol, value in replace(self, origin=()).figures.items()}
            return replace(CONVENTIONS[convention](**own), origin=steps(self.origin))
        (turn,) = steps((self.turn,))
        return replace(self, origin=steps(self.origin), reach=steps(self.reach), mount=steps(self.mount), turn=turn,
                       body=steps(self.body))  # fmt: skip

    @property
    def skeleton(self) -> Frame:
        """The frame with all values zero, and no parameter."""

        def bare(steps: tuple[Step, ...]) -> tuple[Step, ...]:
            return tuple(Step(step.motion, step.symbol) for step in steps)

        (turn,) = bare((self.turn,))
        return Frame(turn, bare(self.reach), bare(self.mount), bare(self.body), self.listed, bare(self.origin))

    def free(self, place: Place) -> tuple[Step, ...]:
        """Return the steps whose errors are independent parameters at a place in the chain, in table order."""
        return tuple(step for step in self.every if place in step.free)

    @property
    def every(self) -> tuple[Step, ...]:
        """All steps, in table order."""
        order = {symbol: k for k, symbol in enumerate(self.listed)}
        return tuple(sorted(self.steps, key=lambda step: order.get(step.symbol, len(order))))

    @property
    def slide(self) -> Step | None:
        """The step that a prismatic joint's variable is added to, if there is one."""
        return next((step for step in self.body if step.motion == "tz"), None)


Convention = Callable[..., Frame]  # states a frame by alpha, a, d, theta and beta [rad and m]


def dh(*, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0, beta: float = 0.0) -> Frame:
    """Return the frame Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) of Denavit and Hartenberg (1955).

    The first joint's theta and d belong to the base. If the next axis is nearly parallel, d along it is replaced by
    beta (Hayati 1983); the last link's d is kept, its a, alpha and beta belong to the tool.
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

    The first joint's parameters all belong to the base. If the previous axis is nearly parallel, d is replaced by beta
    (Hayati 1983; equations 1 and 6 of the HH800 paper).
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
    """Return a frame placed at an origin [m, and rad about x, y and z in turn] on a link that carries several joints.

    All six coordinates have errors, like those of a base in the measuring frame.
    """
    figures = zip((*SHIFTS, *TURNS), STANDS, (*origin, *rotation), strict=True)
    return replace(
        frame, origin=tuple(Step(motion, symbol, float(value), STARTING) for motion, symbol, value in figures)
    )


def follows(frame: Frame, convention: str) -> bool:
    """Return whether a frame follows a convention, regardless of its origin."""
    bare = replace(frame, origin=())
    figures = bare.figures
    return set(figures) == {"alpha", "a", "d", "theta", "beta"} and bare == CONVENTIONS[convention](**figures)


def convention_of(frames: Sequence[Frame]) -> str | None:
    """Return the convention that all frames follow; None if there is none."""
    return next((name for name in CONVENTIONS if all(follows(frame, name) for frame in frames)), None)


def _parallel(alpha: float) -> bool:
    return bool(abs(np.sin(alpha)) < PARALLEL)


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a tuple of floats."""
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class FrameOrigin:
    """The pose of a frame in another: translation xyz [m], and rotation rpy [rad] about fixed x, y and z in turn."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> np.ndarray:
        """The rotation matrix (3, 3)."""
        roll, pitch, yaw = self.rpy
        return about(2, yaw) @ about(1, pitch) @ about(0, roll)

    def at(self, point: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return a point (3,) of the frame in coordinates of the other frame."""
        return np.array(self.xyz) + self.rotation @ np.array(point)

    @property
    def inverse(self) -> FrameOrigin:
        """The inverse transform."""
        if self == FrameOrigin():
            return self
        x, y, z = map(float, -self.rotation.T @ np.array(self.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation.T))

    def then(self, inner: FrameOrigin) -> FrameOrigin:
        """Return the composition with an inner origin, stated in this frame."""
        if self == FrameOrigin():
            return inner
        if inner == FrameOrigin():
            return self
        x, y, z = map(float, self.at(inner.xyz))
        return FrameOrigin((x, y, z), rpy_of(self.rotation @ inner.rotation))


def about(axis: int, angle: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) about an axis (0: x, 1: y, 2: z)."""
    matrix, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j] = -matrix[j, i]
    return matrix


def rpy_of(rotation: np.ndarray) -> Vector:
    """Return the angles about fixed x, y and z in turn [rad] of a rotation matrix (3, 3)."""
    across = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = float(np.arctan2(-rotation[2, 0], across))
    # Near gimbal lock the rotations about x and z nearly coincide: x absorbs the rounding of z, and at lock all of it.
    yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0])) if across > NO_TURN else 0.0
    y = np.cos(yaw) * rotation[1] - np.sin(yaw) * rotation[0]
    return float(np.arctan2(-y[2], y[1])), pitch, yaw


@dataclass(frozen=True)
class Axis:
    """A joint's axis: a unit vector in the joint's frame, and whether the joint is revolute or prismatic."""

    direction: Vector
    slides: bool = False

    @property
    def nearest(self) -> int:
        """The coordinate axis (0 to 2) nearest to it."""
        return int(np.argmax(np.abs(self.direction)))

    @property
    def turns(self) -> tuple[float, float]:
        """The rotations about z and then y [rad] that carry the z axis onto it."""
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
    """Return the frame of a joint at an origin in its parent link; the joint's link shares the joint's axes.

    before: the axis of the previous joint, None for the first; beside: whether the parent link carries another joint
    that already absorbs errors of the link; zero [rad or m]: an offset of the joint's variable; tip: the flange in the
    frame of the last joint. Parameters are x, y, z, two rotations that tilt the axis, and the joint's zero, without
    those redundant with others at every pose (see `origins_left_out`).
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
    """Return the values of an origin's frame that are no parameters, since others are equivalent at every pose."""
    return tuple(step.symbol for step in frame.steps if step.symbol in LISTED and not step.free)


def _tilts(axis: Axis) -> tuple[Motion, ...]:
    """Return the two rotations that tilt an axis: those about the coordinate axes not nearest to it."""
    return tuple(turn for k, turn in enumerate(TURNS) if k != axis.nearest)


def _stated(*steps: Step) -> tuple[Step, ...]:
    """Return the steps with a non-zero value."""
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
    """Return the values whose errors are independent parameters.

    Motions of the joint along or about the previous axis are parameters of the previous joint (for a prismatic one all
    translations, and the rotation about it). Those kept are the best conditioned to span, with these, all small
    motions.
    """
    if before is None:
        return frozenset()  # the base has these parameters
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
    """Return the rotation about an axis, or the translation along it, as an expression (4, 4)."""
    kind, axis = motion
    if kind == "r":
        return _rotation("xyz".index(axis), value)
    return translation(*(value if axis == other else 0 for other in "xyz"))


@lru_cache
def moving(motion: Motion) -> ca.Function:
    """Return the function (value, point) -> transformed point: calling it takes a third of the time of building it."""
    value, point = ca.SX.sym("value"), ca.SX.sym("point", 3)
    return ca.Function("moved", [value, point], [apply(elementary(motion, value), point)])


def placement(v: ca.SX | ca.DM) -> ca.SX:
    """Translation by v[0:3], then rotations about x, y and z by v[3:6], each about the axis already turned."""
    return translation(v[0], v[1], v[2]) @ _rotation(0, v[3]) @ _rotation(1, v[4]) @ _rotation(2, v[5])


def placement_matrix(six: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the numeric transform (4, 4) of a translation [m] and rotations about x, y and z in turn [rad]."""
    return np.array(ca.DM(ca.evalf(placement(ca.DM(list(map(float, six)))))))


def turning(rotation: ca.SX, by: ca.SX) -> ca.SX:
    """Return the rotational Jacobian (3, n) [rad per unit] of a rotation (3, 3) by symbols, about its own axes."""
    x, y, z = (rotation[:, k] for k in range(3))
    slope = ca.jacobian(ca.vec(rotation), by)
    return ca.vertcat(z.T @ slope[3:6, :], x.T @ slope[6:, :], y.T @ slope[:3, :])


def apply(transform: ca.SX, point: ca.SX) -> ca.SX:
    """Return the transformed point (3,)."""
    return transform[:3, :3] @ point + transform[:3, 3]


def crossing(vectors: np.ndarray) -> np.ndarray:
    """Return the skew-symmetric matrices (n, 3, 3) of the cross product with each of vectors (n, 3)."""
    x, y, z = vectors.T
    zero = 0 * x
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Return the rotations (…, 3, 3) nearest to matrices; of Σ b aᵀ, those that turn vectors a closest onto b (Kabsch 1976)."""
    u, _, v = np.linalg.svd(matrix)
    u = u.copy()
    u[..., :, 2] *= np.sign(np.linalg.det(u @ v))[..., None]
    return u @ v


def motion_onto(points: np.ndarray, onto: np.ndarray) -> tuple[float, ...]:
    """Return the pose (6,) that moves points (n, 3) closest onto others (Kabsch 1976); about a line the rotation is arbitrary."""
    centre, aim = points.mean(axis=0), onto.mean(axis=0)
    turn = Rotation.from_matrix(nearest_rotation((onto - aim).T @ (points - centre)))
    return (*(aim - turn.apply(centre)), *angles(turn))


def angles(turn: Rotation, order: str = "XYZ") -> np.ndarray:
    """Return the Euler angles [rad] of a rotation, in an order named as in SciPy.

    At gimbal lock the third angle is zero.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # handled as stated above; common for tools
        return np.asarray(turn.as_euler(order))
