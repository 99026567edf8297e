"""Distances between capsules, and of capsules from boxes: of the segments in their middle, all poses at once.

The skeleton: where a robot's joints, flange, bars and marker are at many poses, by its nominal figures.
The cell: who looks at the robot from where, what stands around it, and which poses it may take there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache, reduce
from itertools import combinations
from typing import Annotated, Literal, NamedTuple, Self

import casadi as ca
import numpy as np
from pydantic import Field as Rule
from pydantic import model_validator

from calflow.files.toml import Angle, Length, Lengths3, Record, Unit
from calflow.model import Model, over_rows
from calflow.robot.frames import apply, placement_matrix
from calflow.robot.mechanism import Deflection, nominal_dimensions, pose
from calflow.robot.robot import Robot

SHORT = 1e-18  # m² (m⁴): a segment's squared length, or that of two segments' cross product, that counts as zero
USUAL_RADIUS = 0.04  # of a link, in lengths of the stretched arm: what the library's robots have, about
TOUCHING = 1e-9  # m: a line through a thing is so near to it at most, by rounding
BLOCK_POSES = 8192  # poses at once: what a processor's cache holds


def between_segments(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances [m] of segments from a to b and from c to d, each (n, 3), shape (n,).

    Nearest points as in Ericson, Real-Time Collision Detection (2005), section 5.1.9; a segment may be a point.
    """
    first, second, apart = b - a, d - c, a - c
    p, q, mixed = _dot(first, first), _dot(second, second), _dot(first, second)
    along, across = _dot(first, apart), _dot(second, apart)
    s = np.clip(_share(mixed * across - along * q, p * q - mixed**2), 0, 1)
    t = np.clip(_share(mixed * s + across, q), 0, 1)
    s = np.clip(_share(mixed * t - along, p), 0, 1)
    return np.linalg.norm(apart + s[:, None] * first - t[:, None] * second, axis=1)


def from_box(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the distances [m] of segments from a to b, each (n, 3), from a box with these corners (3,), shape (n,).

    The squared distance along a segment is convex, and its slope is straight between the places where the segment passes one of
    the box's six planes: where the slope is zero is found exactly.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    start, way = a - middle, b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = np.hstack([(half - start) / way, (-half - start) / way])
    ends = np.tile([0.0, 1.0], (len(a), 1))
    at = np.sort(np.hstack([np.clip(np.nan_to_num(passed), 0, 1), ends]), axis=1)
    points = start[:, None] + at[..., None] * way[:, None]
    slope = _dot(points - np.clip(points, -half, half), way[:, None])
    after = (slope < 0).sum(axis=1).clip(1, at.shape[1] - 1)[:, None]  # the first place where it no longer falls
    (t0, t1), (s0, s1) = ([np.take_along_axis(of, k, axis=1)[:, 0] for k in (after - 1, after)] for of in (at, slope))
    nearest = start + (t0 + (t1 - t0) * np.clip(_share(-s0, s1 - s0), 0, 1))[:, None] * way
    return np.linalg.norm(nearest - np.clip(nearest, -half, half), axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((a * b).sum(axis=-1))


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """A quotient, 0 where the whole is nothing."""
    return np.divide(part, whole, out=np.zeros_like(part), where=np.abs(whole) > SHORT)


class Line(NamedTuple):
    """A line of a skeleton: from its node start to its node end, of a link; way are the lines from the base to its end."""

    start: int
    end: int
    link: int
    way: tuple[int, ...]


@lru_cache(maxsize=16)
def drawn_lines(robot: Robot, flange: int) -> tuple[Line, ...]:
    """Return the lines of a skeleton: to each joint from that which moves its link, to each tip, and from flange to reflector."""
    n, ways = robot.n_joints, [tuple(robot.chain(link)) for link in range(robot.n_joints + 1)]
    inner = [Line(on, i + 1, on, (*ways[on], i)) for i, on in enumerate(robot.parents)]
    tips = [Line(tip, k + 1, tip, (*ways[tip], k)) for k, tip in enumerate(robot.tips, start=n)]
    foot = n + len(robot.tips)
    before = next((tip.way for tip in tips if tip.link == flange), ways[flange])
    return (*inner, *tips, Line(foot + 1, foot + 2, flange, (*before, foot)))


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Points [m] and directions at n poses, in the base's frame as the link on the floor sees it.

    nodes (n, n_joints + n_tips + 3, 3) are the base's origin, each joint's, each tip's, that of the flange, which is the link that
    the reflector is on, and the reflector; lines lead from one to another. axes (n, n_joints, 3) are the joints' axes, flange
    (n, 3, 3) turns the flange's, bars (n, 3 or 0, 3) the pins P, Q and R of a loop.
    """

    lines: tuple[Line, ...]
    nodes: np.ndarray
    axes: np.ndarray
    flange: np.ndarray
    bars: np.ndarray

    @property
    def marker(self) -> np.ndarray:
        """The reflector, (n, 3)."""
        return self.nodes[:, -1]

    @classmethod
    def of(cls, robot: Robot, readings: np.ndarray, marker: str) -> Self:
        """Return the skeletons at joint readings (n, n_joints) [rad, or m]."""
        points = _function(robot, marker)
        (values,) = over_rows(points, np.zeros(0), np.asarray(readings @ robot.reading_matrix.T).T)
        every = values.T.reshape(len(readings), -1, 3)
        n = robot.n_joints
        ends = np.cumsum([n + len(robot.tips) + 3, n, 3])
        nodes, axes, flange, bars = np.split(every, ends, axis=1)
        return cls(
            drawn_lines(robot, robot.link(robot.markers[marker].on)), nodes, axes, np.swapaxes(flange, 1, 2), bars
        )

    def part(self, which: np.ndarray) -> Self:
        """Return some of the poses: indices, or a mask (n,)."""
        return type(self)(self.lines, *(getattr(self, field.name)[which] for field in fields(self)[1:]))


@lru_cache(maxsize=16)
def line_lengths(robot: Robot) -> np.ndarray:
    """Return the largest length [m] of each line but the last, from flange to reflector, shape (n_joints + n_tips,)."""
    at = Skeleton.of(robot, robot.limits.T @ robot.angle_matrix.T, next(iter(robot.markers)))
    start, end = ([getattr(line, name) for line in at.lines[:-1]] for name in ("start", "end"))
    return np.asarray(np.linalg.norm(at.nodes[:, end] - at.nodes[:, start], axis=2).max(axis=0))


def reflector(robot: Robot, marker: str, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the expressions of the marker (3,) and of its flange's turn (3, 3) at driven joint angles q (n_joints,)."""
    point = _function(robot, marker)(ca.SX(0, 1), q)
    nodes = 3 * (robot.n_joints + len(robot.tips) + 3)
    turn = nodes + 3 * robot.n_joints
    return point[nodes - 3 : nodes], ca.reshape(point[turn : turn + 9], 3, 3)


@lru_cache(maxsize=16)
def _function(robot: Robot, marker: str) -> ca.Function:
    """The function of driven joint angles that gives all points and directions, one after the other."""
    q = ca.SX.sym("q", robot.n_joints)
    at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints))
    stands = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
    flange = at.frame(robot, robot.link(robot.markers[marker].on))
    reflector = apply(flange, ca.SX(ca.DM(robot.markers[marker].point)))
    bars = []
    if robot.loop:
        crank, rod = at.bars
        bars = [crank[:3, 3], rod[:3, 3], rod[:3, 3] + robot.loop.rod.length * rod[:3, 0]]
    places = [at.ends[0], *at.joints, *(at.frame(robot, tip) for tip in robot.tips), flange]
    nodes = [at.grounded(robot, point) for point in (*(place[:3, 3] for place in places), reflector)]
    turned = [stands @ axis for axis in (*(joint[:3, 2] for joint in at.joints), *ca.horzsplit(flange[:3, :3]))]
    points = [at.grounded(robot, point) for point in bars]
    return ca.Function("skeleton", [ca.SX.sym("p", 0), q], [ca.densify(ca.vertcat(*nodes, *turned, *points))])


@dataclass(frozen=True)
class CellStation(Record):
    """A table `[[stages.select.cell.stations]]`: a device that must see the reflector."""

    origin: Annotated[Lengths3, Rule(description="where it stands in the measuring frame, e.g. `origin_mm`")]
    range_min: Annotated[Length, Rule(ge=0, description="how near it measures, e.g. `range_min_m`")] = 0.0
    range_max: Annotated[Length | None, Rule(gt=0, description="how far it measures")] = None
    elevation_min: Annotated[
        Angle, Rule(description="how low it looks, from the horizontal (x and y of the measuring frame), e.g. `elevation_min_deg`")
    ] = -np.pi / 2  # fmt: skip
    elevation_max: Annotated[Angle, Rule(description="how high it looks")] = np.pi / 2

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.range_min >= self.far:
            raise ValueError("range_min must lie below range_max")
        if self.elevation_min >= self.elevation_max:
            raise ValueError("elevation_min must lie below elevation_max")
        return self

    @property
    def far(self) -> float:
        """How far it measures [m]; without end where nothing is stated."""
        return np.inf if self.range_max is None else self.range_max


@dataclass(frozen=True)
class Box(Record):
    """A box along the axes of the frame that it is in."""

    min: Annotated[Lengths3, Rule(description="its least x, y and z, e.g. `min_mm`")]
    max: Annotated[Lengths3, Rule(description="its largest x, y and z, e.g. `max_mm`")]

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError("expected min < max along every axis")
        return self


@dataclass(frozen=True)
class Cylinder(Record):
    """A table `[[stages.select.cell.cylinders]]`: its ends count as rounded, so that it is longer by its radius at either end."""

    start: Annotated[Lengths3, Rule(description="where its axis begins, e.g. `start_mm`")]
    end: Annotated[Lengths3, Rule(description="where its axis ends, e.g. `end_mm`")]
    radius: Annotated[Length, Rule(gt=0, description="its radius, e.g. `radius_mm`")]


Radii = Annotated[tuple[Annotated[float, Rule(gt=0)], ...], Unit("length")]
Angles = Annotated[tuple[float, ...], Unit("angle")]


@dataclass(frozen=True)
class Cell(Record):
    """What poses must keep to, the table `[stages.select.cell]`; what is not stated is not asked for.

    Links are capsules from joint to joint and to the flange.
    """

    stations: Annotated[
        tuple[CellStation, ...], Rule(description="tables: the devices that must see the reflector")
    ] = ()
    reflector_axis: Annotated[
        tuple[float, float, float], Rule(description="where the reflector looks, in the flange's frame; its z")
    ] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle | None, Rule(
        gt=0, le=np.pi, description="how far off that axis a station may be: half the cone's opening, e.g. `acceptance_deg`",
    )] = None  # fmt: skip
    line_of_sight: Annotated[
        bool, Rule(description="whether links, boxes and cylinders may not stand between a station and the reflector")
    ] = True
    sight_from: Annotated[
        Length,
        Rule(ge=0, description="how far off the reflector a line of sight begins to count, e.g. `sight_from_mm`"),
    ] = 0.0
    link_radii: Annotated[Radii | None, Rule(
        description="the links' radii, one a joint, e.g. `link_radii_mm`; 4 % of the stretched arm's length. The base has the "
        "first one's, the bars of a loop the least",
    )] = None  # fmt: skip
    tool_radius: Annotated[
        Length | None,
        Rule(gt=0, description="radius of a capsule from the flange to the reflector, e.g. `tool_radius_mm`; no tool"),
    ] = None
    self_collision: Annotated[bool, Rule(
        description="whether links may not touch each other: those that have a link between them longer than both radii",
    )] = True  # fmt: skip
    clearance: Annotated[
        Length, Rule(ge=0, description="what links keep from each other and from what is drawn, e.g. `clearance_mm`")
    ] = 0.0
    frame: Annotated[Literal["base", "measuring"], Rule(
        description="the frame in which floor, boxes and cylinders are drawn: the `base`'s or the `measuring` one",
    )] = "base"  # fmt: skip
    floor: Annotated[
        Length | None,
        Rule(description="height of the floor, e.g. `floor_mm`; it and the boxes do not count for base and first link"),
    ] = None
    boxes: Annotated[tuple[Box, ...], Rule(description="tables: boxes that stand around")] = ()
    cylinders: Annotated[tuple[Cylinder, ...], Rule(description="tables: cylinders that stand around")] = ()
    configuration: Annotated[Angles | None, Rule(
        description="readings of the six joints at a pose whose elbow and wrist are kept, e.g. `configuration_deg`",
    )] = None  # fmt: skip
    torque_share: Annotated[
        float | None,
        Rule(gt=0, description="how much of each joint's `rated_torque` the robot and its payload may take to hold"),
    ] = None

    @model_validator(mode="after")
    def _points_somewhere(self) -> Self:
        if not any(self.reflector_axis):
            raise ValueError("reflector_axis must not be zero")
        if self.acceptance is not None and not self.stations:
            raise ValueError("acceptance needs a station to look at: a table [[stages.select.cell.stations]]")
        return self

    def wrong(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Say what does not fit the robot, with the key that says it."""
        if self.link_radii is not None and len(self.link_radii) != robot.n_joints:
            yield f"expected {robot.n_joints} radii, one a joint, found {len(self.link_radii)}", "link_radii"
        arm = [robot.joints[i] for i in robot.arm]
        if self.configuration is not None:
            if not robot.is_one_arm or len(arm) != 6 or any(joint.kind != "revolute" for joint in arm):
                yield "elbow and wrist are known of arms of six joints that turn", "configuration"
            elif len(self.configuration) != 6:
                yield f"expected 6 joint readings, found {len(self.configuration)}", "configuration"
        if self.torque_share is not None and not (robot.has_masses and any(joint.rated_torque for joint in arm)):
            yield "needs masses and rated_torque of joints in the robot file", "torque_share"

    def refusals(self, model: Model, conditions: np.ndarray, marker: str) -> np.ndarray:
        """Return which of RULES is the first to refuse each of packed rows (n_conditions, n), from 1; 0 where none does."""
        refusal = np.zeros(conditions.shape[1], dtype=int)
        for begin in range(0, len(refusal), BLOCK_POSES):
            left = np.arange(begin, min(begin + BLOCK_POSES, len(refusal)))
            at = Skeleton.of(model.robot, conditions[: model.robot.n_joints, left].T, marker)
            for number, rule in enumerate(RULES.values(), start=1):
                good = reduce(np.logical_and, rule(self, model, conditions[:, left], at), np.full(len(left), True))
                refusal[left[~good]] = number
                left, at = left[good], at.part(good)
        return refusal

    def radii(self, robot: Robot) -> np.ndarray:
        """Return the radius [m] of every link, the base's first, shape (n_joints + 1,)."""
        if self.link_radii is None:
            lengths = line_lengths(robot)
            reach = max(lengths[list(line.way)].sum() for line in drawn_lines(robot, 0)[:-1])
            return np.full(robot.n_joints + 1, USUAL_RADIUS * reach)
        return np.array([self.link_radii[0], *self.link_radii])


def refused_words(refusals: np.ndarray) -> str:
    """Say how many poses each rule refused, of whose first refusals (n,) these are, and how many none did."""
    counts = np.bincount(refusals, minlength=len(RULES) + 1)
    reasons = [f"{name} {number}" for name, number in zip(RULES, counts[1:], strict=True) if number]
    return f"the cell allows {counts[0]} of {len(refusals)} poses; refused by {', '.join(reasons) or 'nothing'}"


def configuration(robot: Robot, at: Skeleton) -> np.ndarray:
    """Return on which side of stretched elbow and wrist of a six-joint arm are, -1 or 1, shape (n, 2)."""
    arm = robot.arm
    upper, lower = at.nodes[:, arm[2] + 1] - at.nodes[:, arm[1] + 1], at.nodes[:, arm[4] + 1] - at.nodes[:, arm[2] + 1]
    elbow = (np.cross(upper, lower) * at.axes[:, arm[2]]).sum(axis=1)
    wrist = (np.cross(at.axes[:, arm[3]], at.axes[:, arm[5]]) * at.axes[:, arm[4]]).sum(axis=1)
    return np.sign(np.stack([elbow, wrist], axis=1))


def checked_pairs(cell: Cell, robot: Robot, lines: Sequence[Line]) -> list[tuple[int, int]]:
    """Return the pairs of capsules that may not touch: not neighbours, nor such as the links between never part by their radii."""
    lengths, radii = line_lengths(robot), _radii(cell, robot, lines)
    ways = [set(line.way) for line in lines]
    return [
        (i, j)
        for i, j in combinations(range(len(radii)), 2)
        if lengths[sorted((ways[i] ^ ways[j]) - {i, j})].sum() > radii[i] + radii[j] + cell.clearance
    ]


def standing_lines(robot: Robot, lines: Sequence[Line]) -> list[int]:
    """Return the lines that stand where the robot does: of base and rail, and of what the first joint of an arm turns."""
    chains = [robot.chain(line.link) for line in lines[:-1]]
    return [k for k, chain in enumerate(chains) if not any(i in robot.arm for i in chain[:-1])]


def _radii(cell: Cell, robot: Robot, lines: Sequence[Line]) -> np.ndarray:
    """The radii of the capsules about lines, the last one's only where the tool has any."""
    tool = [] if cell.tool_radius is None else [cell.tool_radius]
    return np.array([*cell.radii(robot)[[line.link for line in lines[:-1]]], *tool])


def _capsules(
    cell: Cell, robot: Robot, at: Skeleton, lines: Sequence[Line]
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Start, end (n, 3) and radius of each capsule about some of a skeleton's lines, and of the bars."""
    for line, radius in zip(lines, _radii(cell, robot, at.lines), strict=False):
        yield at.nodes[:, line.start], at.nodes[:, line.end], radius
    for k in range(max(0, at.bars.shape[1] - 1)):
        yield at.bars[:, k], at.bars[:, k + 1], cell.radii(robot).min()


def _stands(robot: Robot) -> np.ndarray:
    """The base in the measuring frame (4, 4)."""
    return placement_matrix([*robot.base.origin, *robot.base.rotation])


def _drawn(cell: Cell, robot: Robot, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the base's frame in that of the drawing."""
    stands = _stands(robot)
    return points if cell.frame == "base" else points @ stands[:3, :3].T + stands[:3, 3]


def _views(cell: Cell, robot: Robot, at: Skeleton) -> Iterator[tuple[CellStation, np.ndarray]]:
    """Each station, and the way (n, 3) from the reflector to it, in the base's frame."""
    stands = _stands(robot)
    for station in cell.stations:
        yield station, (np.array(station.origin) - stands[:3, 3]) @ stands[:3, :3] - at.marker


def _obstacles(cell: Cell, start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """The distances (n,) of segments from each thing drawn but the floor, in the drawing's frame."""
    for box in cell.boxes:
        yield from_box(start, end, np.array(box.min), np.array(box.max))
    for cylinder in cell.cylinders:
        ends = (np.broadcast_to(np.array(place), start.shape) for place in (cylinder.start, cylinder.end))
        yield between_segments(start, end, *ends) - cylinder.radius


def _like(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    if cell.configuration is not None:
        readings = np.zeros((1, model.robot.n_joints))
        readings[:, model.robot.arm] = cell.configuration
        kept = configuration(model.robot, Skeleton.of(model.robot, readings, next(iter(model.robot.markers))))
        yield (configuration(model.robot, at) == kept).all(axis=1)


def _carried(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    if cell.torque_share is not None:
        rigid = Model(model.robot, (), model.given)
        (torque,) = rigid.figures("torque", lambda p, c, at: [at.state.torque], rigid.nominal, conditions)
        rated = [np.inf if joint.rated_torque is None else joint.rated_torque for joint in model.robot.joints]
        yield (np.abs(torque[:, :, 0]) <= cell.torque_share * np.array(rated)).all(axis=1)


def _in_range(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    for station, way in _views(cell, model.robot, at):
        distance = np.linalg.norm(way, axis=1)
        yield (distance >= station.range_min) & (distance <= station.far)


def _at_elevation(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    up = _stands(model.robot)[2, :3]
    for station, way in _views(cell, model.robot, at):
        elevation = np.arcsin(np.clip(-way @ up / np.linalg.norm(way, axis=1).clip(1e-12), -1, 1))
        yield (elevation >= station.elevation_min) & (elevation <= station.elevation_max)


def _accepted(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    if cell.acceptance is not None:
        axis = at.flange @ (np.array(cell.reflector_axis) / np.linalg.norm(cell.reflector_axis))
        for _, way in _views(cell, model.robot, at):
            yield (axis * way).sum(axis=1) >= np.cos(cell.acceptance) * np.linalg.norm(way, axis=1)


def _apart(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    radii = _radii(cell, model.robot, at.lines)
    for i, j in checked_pairs(cell, model.robot, at.lines) if cell.self_collision else ():
        apart = between_segments(*(at.nodes[:, node] for k in (i, j) for node in at.lines[k][:2]))
        yield apart > radii[i] + radii[j] + cell.clearance


def _clear(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    robot = model.robot
    standing = standing_lines(robot, at.lines)
    for k, (start, end, radius) in enumerate(_capsules(cell, robot, at, at.lines)):
        if k not in standing:
            a, b = _drawn(cell, robot, start), _drawn(cell, robot, end)
            if cell.floor is not None:
                yield np.minimum(a[:, 2], b[:, 2]) > cell.floor + radius + cell.clearance
            yield from (distance > radius + cell.clearance for distance in _obstacles(cell, a, b))


def _seen(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    for _, way in _views(cell, model.robot, at) if cell.line_of_sight else ():
        length = np.linalg.norm(way, axis=1, keepdims=True).clip(1e-12)
        start, end = at.marker + way * np.minimum(1, cell.sight_from / length), at.marker + way
        for a, b, radius in _capsules(cell, model.robot, at, at.lines[:-1]):
            yield between_segments(start, end, a, b) > radius
        drawn = (_drawn(cell, model.robot, point) for point in (start, end))
        yield from (distance > TOUCHING for distance in _obstacles(cell, *drawn))


RULES: Mapping[str, Callable[[Cell, Model, np.ndarray, Skeleton], Iterator[np.ndarray]]] = {
    "another configuration": _like,
    "payload": _carried,
    "range": _in_range,
    "elevation": _at_elevation,
    "acceptance of the reflector": _accepted,
    "links that touch each other": _apart,
    "floor, boxes or cylinders": _clear,
    "line of sight": _seen,
}  # in the order in which they are asked; each says which poses each thing that it looks at allows, (n,)
