"""The mechanism: forward kinematics of every joint, link end and marker at a pose, and the static loads on them.

Inputs are dimensions, masses, a row's conditions, and small elastic deflections of each part. A four-bar loop PQRS,
closed exactly for any lengths, maps two motor angles to its driven joint's. Loads are the gradient of one potential
energy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from hashlib import sha256
from itertools import accumulate
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np

from calflow.robot.frames import SHIFTS, TURNS, Motion, Step, apply, elementary, moving, placement, translation
from calflow.robot.parts import FourBar, Marker, Payload
from calflow.robot.robot import Robot

Parts = TypeVar("Parts", bound=Any)
At = TypeVar("At", ca.SX, "FrameChain")
BY_JOINT = ("approach", "travel", "torque", "speed", "acceleration")
NUMBERED = {"camera_number": "camera", "target_number": "target"}  # the label that each is the number of
OPTIONAL = (
    "approach", "travel", "wrench", "torque", "time", "temperature", "order", "range", "session", "speed", "acceleration",
    "image_row", *NUMBERED,
)  # fmt: skip
READINGS = "q{joint}_{deg|mm}"  # the columns of joint readings
VIAS = "via{joint}_{deg|mm}"  # the same for a via pose
DEAD_POINT = 0.97  # |cosine| of the closure beyond which a loop is too near its dead point
WAY_POINTS = 21
SMALLEST_RATED = 1.0  # Nm, where gravity loads no joint at all


@dataclass(frozen=True)
class Dimensions:
    """Every length and angle of a robot and its tool.

    base (6,), tool_rotation (3,): errors in the base's and the tool's own frame (see `frames.placement`); steps: values
    of the frames' steps, joint by joint (see `Robot.step_index`); bars (3,): crank, rod, rocker; markers (3,
    n_markers): in their links' frames; markers_turn (3,): rotation, about the first marker, of those with known
    relative positions; side (1,): see `assembly_side`. SI.
    """

    base: ca.SX
    steps: ca.SX
    bars: ca.SX
    tool_rotation: ca.SX
    markers: ca.SX
    markers_turn: ca.SX
    side: ca.SX


@dataclass(frozen=True)
class Loads:
    """Masses, centres of mass and gravity, in SI.

    mass (n_joints,), com (3, n_joints): of the links, in their frames; bar_mass (2,), bar_com (3, 2): of crank and rod;
    payload_mass (n_payloads,), payload_com (3, n_payloads): in the frames of the links that carry them; gravity (3,):
    in the frame of the link that stands on the floor, like the robot's.
    """

    mass: ca.SX
    com: ca.SX
    bar_mass: ca.SX
    bar_com: ca.SX
    payload_mass: ca.SX
    payload_com: ca.SX
    gravity: ca.SX


@lru_cache(maxsize=16)
def nominal_dimensions(robot: Robot) -> Dimensions:
    """Return the dimensions that the maker states."""
    loop = robot.loop
    return Dimensions(
        base=_column([0.0] * 6),
        steps=_column([step.value for step in robot.steps]),
        bars=_column([loop.crank.length, loop.rod.length, loop.rocker] if loop else []),
        tool_rotation=_column([0.0] * 3),
        markers=_points([marker.point for marker in robot.markers.values()]),
        markers_turn=_column([0.0] * 3),
        side=_column([assembly_side(robot)]),
    )


@lru_cache(maxsize=16)
def nominal_loads(robot: Robot) -> Loads:
    """Return the masses that the maker states; a missing mass counts as zero."""
    bars = [robot.loop.crank, robot.loop.rod] if robot.loop else []
    payloads = robot.payloads.values()
    return Loads(
        mass=_column([joint.mass or 0.0 for joint in robot.joints]),
        com=_points([joint.com for joint in robot.joints]),
        bar_mass=_column([bar.mass or 0.0 for bar in bars]),
        bar_com=_points([bar.com for bar in bars]),
        payload_mass=_column([payload.mass or 0.0 for payload in payloads]),
        payload_com=_points([payload.com for payload in payloads]),
        gravity=_column(robot.gravity),
    )


def symbols_like(parts: Parts) -> Parts:
    """Return a data class of expressions with each replaced by symbols of the same shape."""
    return replace(parts, **{name: ca.SX.sym(name, *value.shape) for name, value in vars(parts).items()})


def _column(values: object) -> ca.SX:
    return ca.SX(ca.DM(np.array(values, dtype=float).reshape(-1, 1)))


def _points(points: object) -> ca.SX:
    return ca.SX(ca.DM(np.array(points, dtype=float).reshape(-1, 3).T))


def name_number(name: str) -> float:
    """Return the integer that encodes a name (of a session, say) in packed rows; 0 means none.

    It is 52 bits of the name's SHA-256, so that collisions are practically impossible.
    """
    return 1.0 + int(sha256(name.encode()).hexdigest()[:13], 16)


@dataclass(frozen=True)
class Row:
    """Symbols of one row's conditions, in SI; an optional condition absent from the data is structurally zero.

    reading: joint readings; q: joint angles (signs and couplings resolved); payload, marker: one-hot over the robot's
    names; approach: direction each joint came from (-1, 0, +1); travel: distance since it last reversed; wrench: force
    and moment at the marker, in the base frame; torque: measured motor torques, which replace the computed ones; time:
    from the first row; order: position in measuring order; range: distance from the measuring device; session, and of
    images camera_number, target_number: see `name_number`; speed, acceleration: first and second time derivatives of
    readings, zero if unknown; image_row: of images of a moving arm, how far below the first row the point is [px].
    """

    reading: ca.SX
    payload: ca.SX
    marker: ca.SX
    approach: ca.SX
    travel: ca.SX
    wrench: ca.SX
    torque: ca.SX
    time: ca.SX
    temperature: ca.SX
    order: ca.SX
    range: ca.SX
    session: ca.SX
    speed: ca.SX
    acceleration: ca.SX
    image_row: ca.SX
    camera_number: ca.SX
    target_number: ca.SX
    q: ca.SX

    @staticmethod
    def sizes(robot: Robot, given: tuple[str, ...] = ()) -> dict[str, int]:
        """Return the length of each condition in a packed row, in order; given: optional conditions in the data."""
        n = robot.n_joints
        fixed = {"reading": n, "payload": len(robot.payloads), "marker": len(robot.markers)}
        optional = dict.fromkeys(OPTIONAL, 1) | dict.fromkeys(BY_JOINT, n) | {"wrench": 6}
        return fixed | {name: size for name, size in optional.items() if name in given}

    @staticmethod
    def spans(robot: Robot, given: tuple[str, ...] = ()) -> dict[str, slice]:
        """Return the slice of each condition in a packed row, as in `sizes`."""
        sizes = Row.sizes(robot, given)
        return {
            name: slice(end - size, end)
            for (name, size), end in zip(sizes.items(), accumulate(sizes.values()), strict=True)
        }

    @staticmethod
    def symbols(robot: Robot, given: tuple[str, ...] = OPTIONAL) -> Row:
        """Return a row of symbols."""
        return Row.unpack(robot, ca.SX.sym("c", sum(Row.sizes(robot, given).values())), given)

    @staticmethod
    def unpack(robot: Robot, packed: ca.SX, given: tuple[str, ...] = ()) -> Row:
        """Split a packed row."""
        parts = {name: ca.SX(size, 1) for name, size in Row.sizes(robot, OPTIONAL).items()}
        parts |= {name: packed[span] for name, span in Row.spans(robot, given).items()}
        return Row(**parts, q=ca.sparsify(ca.DM(robot.reading_matrix)) @ parts["reading"])


def reading_columns(robot: Robot) -> list[str]:
    """Return the column names of joint readings, e.g. q1_deg, without joints that follow others."""
    return [f"q{i + 1}_{robot.joints[i].shown[0]}" for i in robot.driven]


def reading_labels(robot: Robot) -> list[str]:
    """Return display labels of joint readings, e.g. q1 [deg]."""
    return [f"q{i + 1} [{robot.joints[i].shown[0]}]" for i in robot.driven]


def shown_readings(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Return readings (n, n_joints) [rad or m] in the units of these columns, shape (n, number of columns)."""
    return np.asarray(readings[:, robot.driven] * [robot.joints[i].shown[1] for i in robot.driven])


Figures = Mapping[str, ca.SX | float]


def figures(robot: Robot, dims: Dimensions, joint: int) -> dict[str, ca.SX]:
    """Return the values of a joint's steps (its index from 0) by symbol [rad and m]."""
    return {step.symbol: dims.steps[robot.step_index(joint, step.symbol)] for step in robot.frames[joint].steps}


@dataclass(frozen=True, eq=False)
class FrameChain:
    """A frame as a chain of elementary transforms: the last one, by a value [rad or m], and the chain before it."""

    motion: Motion = "tx"
    value: ca.SX | float = 0.0
    before: FrameChain | None = None

    def then(self, six: ca.SX | ca.DM) -> FrameChain:
        """Return the chain extended by a `placement`; itself if that is structurally zero."""
        way = self
        for motion, value in zip((*SHIFTS, *TURNS), ca.vertsplit(six) if six.nnz() else (), strict=False):
            way = FrameChain(motion, value, way)
        return way

    @cached_property
    def frame(self) -> ca.SX:
        """The frame (4, 4) at the end of the chain."""
        last = elementary(self.motion, self.value)
        return self.before.frame @ last if self.before else last

    def carried(self, point: ca.SX) -> ca.SX:
        """Return a point (3,) of the frame in coordinates of the start, in a third of the frame's operations."""
        way: FrameChain | None = self
        while way:
            point, way = moving(way.motion)(way.value, point), way.before
        return point


def along(at: FrameChain, steps: Iterable[Step], values: Figures) -> FrameChain:
    """Return the chain extended by steps."""
    for step in steps:
        at = FrameChain(step.motion, values[step.symbol], at)
    return at


def reach_of(robot: Robot, joint: int) -> tuple[Step, ...]:
    """Return the steps from a link's frame to the point where a joint (from 0) attaches to it."""
    return (*robot.frames[joint].origin, *robot.frames[joint].reach)


def to_axis(at: FrameChain, robot: Robot, dims: Dimensions, joint: int) -> FrameChain:
    """Return the chain to a joint's axis, before its rotation, from the end of its parent link."""
    reached = robot.next_joint(robot.parents[joint]) == joint
    steps = robot.frames[joint].mount if reached else (*reach_of(robot, joint), *robot.frames[joint].mount)
    return along(at, steps, figures(robot, dims, joint))


def to_end(at: FrameChain, robot: Robot, dims: Dimensions, joint: int) -> FrameChain:
    """Return the chain from the frame of a joint's link to its end, where the next joint is if there is just one."""
    following = robot.next_joint(joint + 1)
    return at if following is None else along(at, reach_of(robot, following), figures(robot, dims, following))


def span(robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the transform (4, 4) from a joint's axis to the end of its link; for a prismatic joint at zero."""
    link = along(FrameChain(), robot.frames[joint].body, figures(robot, dims, joint))
    return to_end(link, robot, dims, joint).frame


@dataclass(frozen=True)
class Closure:
    """The closed loop at one pose; angles in rad from the ground's x axis in the loop's plane.

    The loop can be closed where |cosine| < 1 (the cosine of the angle at S between the diagonal SQ and the rocker).
    """

    rocker_angle: ca.SX
    rod_angle: ca.SX
    cosine: ca.SX


def assembly_side(robot: Robot) -> int:
    """Return +1 or -1: which of the two closures a robot's loop is assembled in.

    An open loop has P and R on different sides of the diagonal QS, a crossed one on the same side. Moving, a loop keeps its
    side; it is determined in the middle of the two joints' ranges.
    """
    loop = robot.loop
    if loop is None:
        return 1
    link, crank = robot.joints[loop.joint - 2], robot.joints[loop.joint - 1]
    x, y = _pin(robot, loop)
    between = np.mean(crank.range) - np.mean(link.range) - link.frame.turn.value - np.arctan2(y, x)
    return (1 if np.sin(between) > 0 else -1) * (1 if loop.assembly == "open" else -1)


def reachable(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return which joint angles (n_poses, n_joints) a robot's loop reaches without passing a dead point, (n_poses,).

    Every pose is approached in a straight line from the middle of the joints' ranges.
    """
    loop = robot.loop
    if loop is None or not len(q):
        return np.ones(len(q), dtype=bool)
    j = loop.joint - 1
    symbols = ca.SX.sym("link_angle"), ca.SX.sym("crank_angle")
    bars = ca.SX([loop.crank.length, loop.rod.length, loop.rocker])
    pin = elementary("rz", symbols[0])[:2, :2] @ ca.DM(_pin(robot, loop))
    cosine = ca.Function("cosine", symbols, [close(assembly_side(robot), pin, bars, symbols[1]).cosine])
    middle = robot.limits.mean(axis=1)
    ways = middle + np.linspace(0, 1, WAY_POINTS)[:, None, None] * (q - middle)
    angles = ways[..., j - 1].ravel() + robot.frames[j - 1].turn.value, ways[..., j].ravel()
    along = np.array(cosine.map(len(angles[0]))(*angles)).reshape(WAY_POINTS, len(q))
    return np.asarray((np.abs(along) < DEAD_POINT).all(axis=0))


def _pin(robot: Robot, loop: FourBar) -> np.ndarray:
    """Position (2,) of the nominal pin S in the loop's plane, from P, with the arm's joint at zero."""
    arm, driven = robot.frames[loop.joint - 2], robot.frames[loop.joint - 1]
    link = along(FrameChain(), arm.body, arm.figures)
    end = along(link, reach_of(robot, loop.joint - 1), driven.figures).frame
    return np.array(ca.DM(ca.evalf(end[:2, 3]))).ravel()


def close(side: int | ca.SX, pin: ca.SX, bars: ca.SX, crank_angle: ca.SX) -> Closure:
    """Solve the loop for its bar lengths, S's position (2,) in its plane and the crank's angle (`assembly_side`: side).

    With Q = crank e^{i·crank_angle} and D = S - Q, the rocker's direction e^{iφ} follows from |D + rocker e^{iφ}| = rod
    (equation 5 of Model based robot calibration, 2021, solved without its parallelogram assumption).
    """
    crank, rod, rocker = bars[0], bars[1], bars[2]
    dx = pin[0] - crank * ca.cos(crank_angle)
    dy = pin[1] - crank * ca.sin(crank_angle)
    squared = dx**2 + dy**2
    cosine = (rod**2 - squared - rocker**2) / (2 * rocker * ca.sqrt(squared))
    # Beyond its travel the loop has no solution: the clamp keeps derivatives finite, and `cosine` shows it.
    reachable = ca.fmin(ca.fmax(cosine, -1 + 1e-9), 1 - 1e-9)
    rocker_angle = ca.atan2(dy, dx) + side * ca.acos(reachable)
    rod_angle = ca.atan2(dy + rocker * ca.sin(rocker_angle), dx + rocker * ca.cos(rocker_angle))
    return Closure(rocker_angle, rod_angle, cosine)


@dataclass(frozen=True)
class Deflection:
    """Small displacements that load or wear adds to the nominal mechanism [m and rad].

    joint (n_joints,): added to joint angles, a drive's also to those that follow it; bearing (6, n_joints): a twist
    (dx, dy, dz, rx, ry, rz) at each joint's frame; link (6, n_joints + 1): a twist at each link's end, where the next joint is,
    from the base to the flange. A link with several joints, or none, ends in its own frame.
    """

    joint: ca.SX
    bearing: ca.SX
    link: ca.SX

    @staticmethod
    def zero(n_joints: int) -> Deflection:
        """Return the zero deflection."""
        return Deflection(ca.SX(n_joints, 1), ca.SX(6, n_joints), ca.SX(6, n_joints + 1))

    @property
    def is_zero(self) -> bool:
        """Whether no entry can differ from zero."""
        return all(part.nnz() == 0 for part in (self.joint, self.bearing, self.link))

    def __add__(self, other: Deflection) -> Deflection:
        return Deflection(self.joint + other.joint, self.bearing + other.bearing, self.link + other.link)


@dataclass(frozen=True)
class Posture(Generic[At]):
    """The frames (4, 4) of one pose in the robot's base frame, or the chains to them.

    joints: each joint's frame after its rotation; ends: each link's end (from the base to the flange); links: each
    link's frame; bars: those of crank and rod; closure: None without a loop.
    """

    joints: tuple[At, ...]
    ends: tuple[At, ...]
    links: tuple[At, ...]
    bars: tuple[At, ...]
    closure: Closure | None

    def grounded(self: Posture[ca.SX], robot: Robot, point: ca.SX) -> ca.SX:
        """Return a point (3,) of the base frame in coordinates of the link that stands on the floor."""
        if not robot.ground:
            return point
        floor = self.links[robot.ground - 1]
        return floor[:3, :3].T @ (point - floor[:3, 3])

    def down(self: Posture[ca.SX], robot: Robot) -> ca.SX:
        """Return gravity's direction in the base's frame, (3,)."""
        return self.from_floor(robot, ca.SX(ca.DM(robot.down)))

    def from_floor(self: Posture[ca.SX], robot: Robot, direction: ca.SX) -> ca.SX:
        """Return a direction (3,) of the link that stands on the floor in the base's frame."""
        return self.links[robot.ground - 1][:3, :3] @ direction if robot.ground else direction

    @property
    def flange(self) -> At:
        """The last link's frame."""
        return self.ends[-1]

    def frame(self, robot: Robot, link: int) -> At:
        """Return the frame of a link by number, in which its payloads and markers are stated."""
        return self.ends[link] if robot.next_joint(link) is None else self.links[link - 1]

    def carrying(self: Posture[ca.SX], robot: Robot, marker: ca.SX) -> ca.SX:
        """Return the frame of the link that the chosen marker is on; marker is one-hot over markers."""
        return _of_marker(robot, marker, partial(self.frame, robot))


def _of_marker(robot: Robot, choice: ca.SX, on: Callable[[int], ca.SX]) -> ca.SX:
    """Return `on` of the link that carries the chosen marker."""
    first, *others = dict.fromkeys(robot.marker_links)
    chosen = start = on(first)
    for link in others:
        chosen += sum(choice[k] for k, where in enumerate(robot.marker_links) if where == link) * (on(link) - start)
    return chosen


def pose(robot: Robot, dims: Dimensions, q: ca.SX, deflection: Deflection) -> Posture[ca.SX]:
    """Return all frames at driven joint angles q (n_joints,) [rad, or m].

    A joint's frame is the one just after the rotation about its axis (see `frames.Frame`).
    A loop is closed at the displaced position of its pin S in the loop's plane.
    """
    graph = _graph(_skeleton(robot))
    outputs = [ca.sparsify(output) for output in graph(*vars(dims).values(), q, *vars(deflection).values())]
    n = robot.n_joints
    joints, ends = outputs[:n], outputs[n : 2 * n + 1]
    links, rest = outputs[2 * n + 1 : 3 * n + 1], outputs[3 * n + 1 :]
    closure = Closure(*rest[2:]) if robot.loop else None
    return Posture(tuple(joints), tuple(ends), tuple(links), tuple(rest[:2]), closure)


def nominal_posture(robot: Robot, q: ca.SX | None = None) -> Posture[ca.SX]:
    """Return all frames of the nominal robot, which nothing deflects, at driven joint angles; by default all at zero."""
    n = robot.n_joints
    return pose(robot, nominal_dimensions(robot), ca.SX.zeros(n) if q is None else q, Deflection.zero(n))


@dataclass(frozen=True)
class _Symbols:
    """A robot's dimensions, joint angles and deflection as symbols."""

    dims: Dimensions
    q: ca.SX
    deflection: Deflection

    @staticmethod
    def of(robot: Robot) -> _Symbols:
        still = Deflection.zero(robot.n_joints)
        return _Symbols(symbols_like(nominal_dimensions(robot)), ca.SX.sym("q", robot.n_joints), symbols_like(still))

    @property
    def inputs(self) -> tuple[ca.SX, ...]:
        """The symbols, in the order of function inputs."""
        return (*vars(self.dims).values(), self.q, *vars(self.deflection).values())

    @property
    def motion(self) -> ca.SX:
        """The deflection, packed."""
        return ca.vertcat(self.deflection.joint, ca.vec(self.deflection.bearing), ca.vec(self.deflection.link))


@lru_cache(maxsize=64)
def _skeleton(robot: Robot) -> Robot:
    """Return the robot without the figures that are inputs of its graphs, so that all with other figures share these."""
    joints = [replace(joint, frame=joint.frame.skeleton, mass=None, com=(0.0, 0.0, 0.0)) for joint in robot.joints]
    return Robot(
        tuple(joints),
        loop=robot.loop,
        ground=robot.ground,
        couplings=robot.couplings,
        payloads={name: Payload(None, on=payload.on) for name, payload in robot.payloads.items()},
        markers={name: Marker((0.0, 0.0, 0.0), on=marker.on) for name, marker in robot.markers.items()},
    )


@lru_cache(maxsize=16)
def _graph(robot: Robot) -> ca.Function:
    """Return the function (dimensions, q, deflection) -> all frames: calling it takes a tenth of building them."""
    symbols = _Symbols.of(robot)
    at = _ways(FrameChain(), robot, symbols)
    frames = [way.frame for way in (*at.joints, *at.ends, *at.links, *at.bars)]
    return ca.Function("pose", [*symbols.inputs], [*frames, *(vars(at.closure).values() if at.closure else ())])


def _ways(base: FrameChain, robot: Robot, symbols: _Symbols) -> Posture[FrameChain]:
    """Return the chains to all frames, starting from the base."""
    dims, deflection = symbols.dims, symbols.deflection
    driven = symbols.q + ca.sparsify(ca.DM(robot.carried_on)) @ deflection.joint
    angles, closure = _chain_angles(robot, dims, driven, deflection)
    joints, ends, links = list[FrameChain](), [base.then(deflection.link[:, 0])], list[FrameChain]()
    bars: tuple[FrameChain, ...] = ()
    for i, joint in enumerate(robot.joints):
        before = to_axis(ends[robot.parents[i]], robot, dims, i)
        if robot.loop and i == robot.loop.joint - 2 and closure:
            bars = _bar_frames(before, dims, driven[robot.loop.joint - 1], closure)
        values, frame = figures(robot, dims, i), joint.frame
        values[joint.moving.symbol] += angles[i]
        moved = along(before, (frame.turn,), values).then(deflection.bearing[:, i])
        link = along(moved, frame.body, values)
        joints.append(moved)
        links.append(link)
        ends.append(to_end(link, robot, dims, i).then(deflection.link[:, i + 1]))
    return Posture(tuple(joints), tuple(ends), tuple(links), bars, closure)


def marker_point(robot: Robot, dims: Dimensions, q: ca.SX, deflection: Deflection, choice: ca.SX) -> ca.SX:
    """Return the chosen marker's position in the measuring frame; choice is one-hot over markers."""
    twists = bool(deflection.bearing.nnz() or deflection.link.nnz())
    graph = _marker_graph(_skeleton(robot), twists)
    return graph(base_place(robot), *vars(dims).values(), q, *vars(deflection).values(), choice)


@lru_cache(maxsize=16)
def _marker_graph(robot: Robot, twists: bool) -> ca.Function:
    """Return the function (base's place, dimensions, q, deflection, choice) -> marker.

    twists: whether links and bearings deflect.
    """
    symbols, choice, stands = _Symbols.of(robot), ca.SX.sym("marker", len(robot.markers)), ca.SX.sym("stands", 6)
    if not twists:
        still = replace(Deflection.zero(robot.n_joints), joint=symbols.deflection.joint)
        symbols = replace(symbols, deflection=still)
    at = _ways(FrameChain().then(stands).then(symbols.dims.base), robot, symbols)
    place = symbols.dims.markers @ choice
    point = _of_marker(robot, choice, lambda link: at.frame(robot, link).carried(place))
    return ca.Function("marker", [stands, *symbols.inputs, choice], [point])


def base_place(robot: Robot) -> ca.DM:
    """Return the nominal base's pose in the measuring frame, (6,) [m, and rad about x, y and z in turn]."""
    return ca.DM([*robot.base.origin, *robot.base.rotation])


def _chain_angles(
    robot: Robot, dims: Dimensions, driven: ca.SX, deflection: Deflection
) -> tuple[ca.SX, Closure | None]:
    """Return the joint variables of the chain from the driven ones: the loop maps its motor's angle to its joint's."""
    if robot.loop is None:
        return driven, None
    j = robot.loop.joint - 1
    turn = driven[j - 1] + figures(robot, dims, j - 1)[robot.frames[j - 1].turn.symbol]
    arm = _arm(robot, dims, deflection, j - 1)
    pin = (elementary("rz", turn) @ arm)[:2, 3]
    closure = close(dims.side, pin, dims.bars, driven[j])
    # The rod guides the rocker in its plane, so that a slope of the arm at S does not rotate it.
    slope = ca.atan2(arm[1, 0], arm[0, 0])
    angles = ca.SX(driven)
    angles[j] = closure.rocker_angle - (turn + slope) + robot.loop.offset
    return angles, closure


def _arm(robot: Robot, dims: Dimensions, deflection: Deflection, i: int) -> ca.SX:
    """Return the frame at S, x along the arm PS (link i), relative to the arm's joint before its bearing deflects."""
    end, still = span(robot, dims, i), ca.SX.eye(4)
    turns, bend = ca.SX(still), placement(deflection.link[:, i + 1])
    turns[:3, :3] = end[:3, :3]
    # The deflection is in the axes of the link's end. As a difference it adds no operations if it is zero.
    straight = placement(deflection.bearing[:, i]) @ translation(*ca.vertsplit(end[:3, 3]))
    return straight @ (still + turns @ (bend - still) @ turns.T)


def _bar_frames(ground: FrameChain, dims: Dimensions, crank_angle: ca.SX, closure: Closure) -> tuple[FrameChain, ...]:
    crank = FrameChain("rz", crank_angle, ground)
    return crank, FrameChain("rz", closure.rod_angle - crank_angle, FrameChain("tx", dims.bars[0], crank))


@dataclass(frozen=True)
class State:
    """The static loads of one row at the deflected pose [N and Nm].

    q: driven joint angles without deflection; torque: generalised forces of the loads on the driven joints (positive
    along q; the motors hold the opposite); bearing, link: wrenches (fx, fy, fz, mx, my, mz) of the loads at the frames
    of `Deflection`, in those frames; down (3, n_tools): direction of gravity in the frames of `Robot.tools`.
    """

    q: ca.SX
    torque: ca.SX
    bearing: ca.SX
    link: ca.SX
    down: ca.SX

    @staticmethod
    def symbols(robot: Robot) -> State:
        """Return a state of symbols."""
        n = robot.n_joints
        sizes = {"q": (n, 1), "torque": (n, 1), "bearing": (6, n), "link": (6, n + 1), "down": (3, len(robot.tools))}
        return State(**{name: ca.SX.sym(name, *size) for name, size in sizes.items()})


def potential_energy(robot: Robot, loads: Loads, row: Row, at: Posture[ca.SX]) -> ca.SX:
    """Return the gravitational potential energy [J] of all links, the loop's bars and the row's payload."""
    gravity, energy = loads.gravity, ca.SX(0)
    for i, frame in enumerate(at.links):
        energy -= loads.mass[i] * ca.dot(gravity, at.grounded(robot, apply(frame, loads.com[:, i])))
    for i, frame in enumerate(at.bars):
        energy -= loads.bar_mass[i] * ca.dot(gravity, at.grounded(robot, apply(frame, loads.bar_com[:, i])))
    for i, link in enumerate(robot.payload_links):
        mass = row.payload[i] * loads.payload_mass[i]
        energy -= mass * ca.dot(gravity, at.grounded(robot, apply(at.frame(robot, link), loads.payload_com[:, i])))
    return energy


def state(robot: Robot, dims: Dimensions, loads: Loads, row: Row, deflected: Deflection) -> State:
    """Return the loads on the mechanism in a row's deflected pose.

    Each is minus the derivative of the energy with respect to the conjugate motion, so one expression covers joints,
    bearings, link ends and the closed loop. An applied wrench (row.wrench: force at the marker and moment, in the base
    frame) adds its virtual work; measured motor torques, if given, replace the computed joint torques.
    """
    n = robot.n_joints
    there = (*vars(dims).values(), row.q, *vars(deflected).values())
    skeleton = _skeleton(robot)
    force, down = _of_gravity(skeleton)(*there, *vars(loads).values(), row.payload, ca.DM(robot.down))
    if row.wrench.nnz():
        force += _of_wrench(skeleton)(*there, row.marker, row.wrench)
    force = ca.sparsify(force)
    torque = -row.torque if row.torque.nnz() else force[:n]
    return State(row.q, torque, ca.reshape(force[n : 7 * n], 6, n), ca.reshape(force[7 * n :], 6, n + 1), down)


@lru_cache(maxsize=16)
def _of_gravity(robot: Robot) -> ca.Function:
    """Return the function (dimensions, q, deflection, loads, payload, down) -> gravity's generalised forces and direction.

    Calling it takes a twentieth of the time of differentiating the energy again.
    """
    there, loads, row = _Symbols.of(robot), symbols_like(nominal_loads(robot)), Row.symbols(robot, ())
    at = pose(robot, there.dims, there.q, there.deflection)
    force = ca.gradient(-potential_energy(robot, loads, row, at), there.motion)
    down = ca.SX.sym("down", 3)
    towards = at.from_floor(robot, down)
    by_tool = ca.horzcat(*(at.frame(robot, link)[:3, :3].T @ towards for link in robot.tools))
    return ca.Function("gravity", [*there.inputs, *vars(loads).values(), row.payload, down], [force, by_tool])


@lru_cache(maxsize=16)
def _of_wrench(robot: Robot) -> ca.Function:
    """Return the function (dimensions, q, deflection, marker, wrench) -> generalised forces of the wrench."""
    there, row = _Symbols.of(robot), Row.symbols(robot, ("wrench",))
    carrying = pose(robot, there.dims, there.q, there.deflection).carrying(robot, row.marker)
    work = ca.dot(row.wrench[:3], apply(carrying, there.dims.markers @ row.marker))
    # A rotation by w changes the frame by skew(w) @ turn: half of its product with skew(moment) @ turn is the moment's work.
    turn = carrying[:3, :3]
    by_moment = ca.jtimes(ca.vec(turn), there.motion, ca.vec(ca.skew(row.wrench[3:]) @ turn) / 2, True)
    force = ca.gradient(work, there.motion) + by_moment
    return ca.Function("wrench", [*there.inputs, row.marker, row.wrench], [force])


def gravity_torque(robot: Robot) -> ca.Function:
    """Return the nominal robot's function (q, payload one-hot) -> static holding torques of the motors [Nm]."""
    q = ca.SX.sym("q", robot.n_joints)
    row = replace(Row.symbols(robot, ()), q=q)
    still = Deflection.zero(robot.n_joints)
    loads = state(robot, nominal_dimensions(robot), nominal_loads(robot), row, still)
    return ca.Function("gravity_torque", [q, row.payload], [ca.densify(-loads.torque)])


def moment_torques(robot: Robot) -> ca.Function:
    """Return the nominal function (q) -> gravity regressor: derivatives of holding torques by inertial parameters.

    These are masses [kg] and first moments [kg m] of links and bars, in which the torques are linear (Khalil and Dombre
    2002); shape (n_joints, 4 times the number of bodies), without payload.
    """
    q, nominal = ca.SX.sym("q", robot.n_joints), nominal_loads(robot)
    fixed = {"payload_com": nominal.payload_com, "gravity": nominal.gravity}
    free = replace(symbols_like(nominal), payload_mass=0 * nominal.payload_mass, **fixed)
    masses = ca.vertcat(free.mass, free.bar_mass)
    places = ca.vertcat(ca.vec(free.com), ca.vec(free.bar_com))
    row = replace(Row.symbols(robot, ()), q=q, payload=ca.SX(len(robot.payloads), 1))
    torque = -state(robot, nominal_dimensions(robot), free, row, Deflection.zero(robot.n_joints)).torque
    slopes = ca.substitute(
        ca.jacobian(torque, ca.vertcat(masses, places)),
        ca.vertcat(masses, places),
        ca.vertcat(ca.SX.ones(masses.shape), ca.SX.zeros(places.shape)),
    )
    return ca.Function("moment_torques", [q], [ca.densify(slopes)])


@lru_cache(maxsize=16)
def rated_torques(robot: Robot) -> np.ndarray:
    """Return each joint's rated torque [Nm; N if prismatic], (n_joints,), read-only: the maker's, else by gravity.

    If not stated, it is the largest gravity torque over the joints' ranges under the heaviest payload, and for a joint
    that gravity hardly loads (a vertical axis) a tenth of that of the most loaded joint of its kind.
    """
    stated = np.array([joint.rated_torque or np.nan for joint in robot.joints])
    rated = np.where(np.isnan(stated), _gravity_torques(robot), stated) if np.isnan(stated).any() else stated
    rated.flags.writeable = False  # the cached array is shared
    return rated


def _gravity_torques(robot: Robot) -> np.ndarray:
    """Return the largest gravity torques of the joints over their ranges, shape (n_joints,)."""
    function, sample = gravity_torque(robot), spread(robot, 256)
    heaviest = np.zeros(len(robot.payloads))
    if robot.payloads:
        heaviest[int(np.argmax([payload.mass or 0.0 for payload in robot.payloads.values()]))] = 1.0
    torques = np.abs(np.array(function.map(len(sample))(sample.T, np.tile(heaviest[:, None], len(sample)))))
    largest = np.where(reachable(robot, sample), torques, 0.0).max(axis=1)  # none where a loop closes nowhere
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    for kind in (slides, ~slides):
        largest[kind] = np.maximum(largest[kind], max(SMALLEST_RATED, 0.1 * largest[kind].max(initial=0.0)))
    return np.asarray(largest)


def spread(robot: Robot, size: int) -> np.ndarray:
    """Return a low-discrepancy sample of the joints' ranges, (size, n_joints): Roberts' additive recurrence (2018).

    Importing scipy.stats for a better sequence takes longer than checking a study.
    """
    n = robot.n_joints
    ratio = np.roots([1.0, *np.zeros(n - 1), -1.0, -1.0]).real.max()  # x^(n + 1) = x + 1: generalises the golden ratio
    share = np.outer(np.arange(1, size + 1), ratio ** -np.arange(1.0, n + 1)) % 1.0
    lower, upper = robot.limits.T
    return np.asarray(lower + share * (upper - lower))
