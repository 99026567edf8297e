"""The cell: measuring stations, obstacles and the poses allowed by line of sight and freedom from collision."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import combinations
from typing import Annotated, Literal, Self

import casadi as ca
import numpy as np
from pydantic import Field as Rule
from pydantic import model_validator

from calflow.design.skeleton import Line, Skeleton, box_distances, line_lengths, segment_distances, skeleton_lines
from calflow.files.toml import Angle, Length, Lengths3, Record, Unit
from calflow.model import Model, over_rows
from calflow.robot.frames import placement_matrix
from calflow.robot.robot import Robot

RELATIVE_RADIUS = 0.04  # of a link, relative to the stretched arm: typical of the library's robots
RANGE, ELEVATION, ACCEPTANCE = "range", "elevation", "acceptance of the reflector"  # rules of a line of sight
TOUCHING = 1e-9  # m: distance below which a line intersects a body, by rounding


@dataclass(frozen=True)
class CellStation(Record):
    """A table `[[stages.select.cell.stations]]`: a device that must see the reflector."""

    origin: Annotated[Lengths3, Rule(description="its position in the measuring frame, e.g. `origin_mm`")]
    range_min: Annotated[Length, Rule(ge=0, description="least measuring distance, e.g. `range_min_m`")] = 0.0
    range_max: Annotated[Length | None, Rule(gt=0, description="largest measuring distance")] = None
    elevation_min: Annotated[
        Angle, Rule(description="least elevation above the horizontal (x and y of the measuring frame), e.g. `elevation_min_deg`")
    ] = -np.pi / 2  # fmt: skip
    elevation_max: Annotated[Angle, Rule(description="largest elevation")] = np.pi / 2

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.range_min >= self.far:
            raise ValueError("range_min must lie below range_max")
        if self.elevation_min >= self.elevation_max:
            raise ValueError("elevation_min must lie below elevation_max")
        return self

    @property
    def far(self) -> float:
        """Its maximum measuring distance [m]; infinite if not stated."""
        return np.inf if self.range_max is None else self.range_max


@dataclass(frozen=True)
class Box(Record):
    """A box aligned with the axes of its frame."""

    min: Annotated[Lengths3, Rule(description="least x, y and z, e.g. `min_mm`")]
    max: Annotated[Lengths3, Rule(description="largest x, y and z, e.g. `max_mm`")]

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError("expected min < max along every axis")
        return self


@dataclass(frozen=True)
class Cylinder(Record):
    """A table `[[stages.select.cell.cylinders]]`: a capsule, which extends beyond either end by its radius."""

    start: Annotated[Lengths3, Rule(description="start of its axis, e.g. `start_mm`")]
    end: Annotated[Lengths3, Rule(description="end of its axis, e.g. `end_mm`")]
    radius: Annotated[Length, Rule(gt=0, description="its radius, e.g. `radius_mm`")]


Radii = Annotated[tuple[Annotated[float, Rule(gt=0)], ...], Unit("length")]
Angles = Annotated[tuple[float, ...], Unit("angle")]


@dataclass(frozen=True)
class Cell(Record):
    """Constraints on poses, the table `[stages.select.cell]`; what is not stated is not required.

    Links are capsules from joint to joint and to the flange.
    """

    stations: Annotated[
        tuple[CellStation, ...], Rule(description="tables: the devices that must see the reflector")
    ] = ()
    reflector_axis: Annotated[
        tuple[float, float, float], Rule(description="axis of the reflector in the flange frame; its z")
    ] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle | None, Rule(
        gt=0, le=np.pi, description="largest angle between that axis and a station: half the cone's opening, e.g. `acceptance_deg`",
    )] = None  # fmt: skip
    line_of_sight: Annotated[
        bool, Rule(description="whether links, boxes and cylinders must not obstruct the line of sight to a station")
    ] = True
    sight_from: Annotated[
        Length, Rule(ge=0, description="obstructions nearer to the reflector are ignored, e.g. `sight_from_mm`")
    ] = 0.0
    link_radii: Annotated[Radii | None, Rule(
        description="radii of the links, one per joint, e.g. `link_radii_mm`; 4 % of the stretched arm's length. The base has the "
        "first one, the bars of a loop the least",
    )] = None  # fmt: skip
    tool_radius: Annotated[
        Length | None,
        Rule(gt=0, description="radius of a capsule from the flange to the reflector, e.g. `tool_radius_mm`; no tool"),
    ] = None
    self_collision: Annotated[bool, Rule(
        description="whether links must not collide: those with a link between them longer than both radii",
    )] = True  # fmt: skip
    clearance: Annotated[
        Length,
        Rule(ge=0, description="least distance of links from each other and from obstacles, e.g. `clearance_mm`"),
    ] = 0.0
    frame: Annotated[Literal["base", "measuring"], Rule(
        description="frame of floor, boxes and cylinders: `base` or `measuring`",
    )] = "base"  # fmt: skip
    floor: Annotated[
        Length | None,
        Rule(description="height of the floor, e.g. `floor_mm`; base and first link may touch it and the boxes"),
    ] = None
    boxes: Annotated[tuple[Box, ...], Rule(description="tables: boxes as obstacles")] = ()
    cylinders: Annotated[tuple[Cylinder, ...], Rule(description="tables: cylinders as obstacles")] = ()
    configuration: Annotated[Angles | None, Rule(
        description="readings of the six joints at a pose with the required sides of elbow and wrist, e.g. `configuration_deg`",
    )] = None  # fmt: skip
    torque_share: Annotated[
        float | None,
        Rule(gt=0, description="largest static torque of robot and payload, as a share of each joint's `rated_torque`"),
    ] = None

    @model_validator(mode="after")
    def _points_somewhere(self) -> Self:
        if not any(self.reflector_axis):
            raise ValueError("reflector_axis must not be zero")
        if self.acceptance is not None and not self.stations:
            raise ValueError("acceptance needs a station: a table [[stages.select.cell.stations]]")
        return self

    def wrong(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Yield each key that does not fit the robot, and why."""
        if self.link_radii is not None and len(self.link_radii) != robot.n_joints:
            yield f"expected {robot.n_joints} radii, one per joint, found {len(self.link_radii)}", "link_radii"
        arm = [robot.joints[i] for i in robot.arm]
        if self.configuration is not None:
            if not robot.is_one_arm or len(arm) != 6 or any(joint.kind != "revolute" for joint in arm):
                yield "elbow and wrist are defined only for arms with six revolute joints", "configuration"
            elif len(self.configuration) != 6:
                yield f"expected 6 joint readings, found {len(self.configuration)}", "configuration"
        if self.torque_share is not None and not (robot.has_masses and any(joint.rated_torque for joint in arm)):
            yield "needs masses and rated_torque of joints in the robot file", "torque_share"

    def refusals(self, model: Model, conditions: np.ndarray, marker: str) -> np.ndarray:
        """Return the first of RULES, from 1, that rejects each packed row (n_conditions, n); 0 if none does, (n,)."""
        refusal = np.zeros(conditions.shape[1], dtype=int)
        left, at = np.arange(len(refusal)), Skeleton.of(model.robot, conditions[: model.robot.n_joints].T, marker)
        for number, rule in enumerate(RULES.values(), start=1):
            good = reduce(np.logical_and, rule(self, model, conditions[:, left], at), np.full(len(left), True))
            refusal[left[~good]] = number
            left, at = left[good], at.part(good)
        return refusal

    def radii(self, robot: Robot) -> np.ndarray:
        """Return the radius [m] of every link, the base first, shape (n_joints + 1,)."""
        if self.link_radii is None:
            lengths = line_lengths(robot)
            reach = max(lengths[list(line.way)].sum() for line in skeleton_lines(robot, 0)[:-1])
            return np.full(robot.n_joints + 1, RELATIVE_RADIUS * reach)
        return np.array([self.link_radii[0], *self.link_radii])


def refused_words(refusals: np.ndarray) -> str:
    """Return in words how many poses each rule rejected first, and how many were accepted, from refusals (n,)."""
    counts = np.bincount(refusals, minlength=len(RULES) + 1)
    reasons = [f"{name} {number}" for name, number in zip(RULES, counts[1:], strict=True) if number]
    return f"the cell allows {counts[0]} of {len(refusals)} poses; refused by {', '.join(reasons) or 'nothing'}"


def configuration(robot: Robot, at: Skeleton) -> np.ndarray:
    """Return the sides of elbow and wrist of a six-joint arm relative to stretched, -1 or 1, shape (n, 2)."""
    arm = robot.arm
    upper, lower = at.nodes[:, arm[2] + 1] - at.nodes[:, arm[1] + 1], at.nodes[:, arm[4] + 1] - at.nodes[:, arm[2] + 1]
    elbow = (np.cross(upper, lower) * at.axes[:, arm[2]]).sum(axis=1)
    wrist = (np.cross(at.axes[:, arm[3]], at.axes[:, arm[5]]) * at.axes[:, arm[4]]).sum(axis=1)
    return np.sign(np.stack([elbow, wrist], axis=1))


def checked_pairs(cell: Cell, robot: Robot, lines: Sequence[Line]) -> list[tuple[int, int]]:
    """Return the pairs of capsules to check for collision: not neighbours, nor those that always overlap."""
    lengths, radii = line_lengths(robot), _radii(cell, robot, lines)
    ways = [set(line.way) for line in lines]
    return [
        (i, j)
        for i, j in combinations(range(len(radii)), 2)
        if lengths[sorted((ways[i] ^ ways[j]) - {i, j})].sum() > radii[i] + radii[j] + cell.clearance
    ]


def standing_lines(robot: Robot, lines: Sequence[Line]) -> list[int]:
    """Return the lines fixed to the robot's site: of base and rail, and of the link that an arm's first joint turns."""
    chains = [robot.chain(line.link) for line in lines[:-1]]
    return [k for k, chain in enumerate(chains) if not any(i in robot.arm for i in chain[:-1])]


def _radii(cell: Cell, robot: Robot, lines: Sequence[Line]) -> np.ndarray:
    """Return the radii of the capsules about lines, including the last one if the tool has a radius."""
    tool = [] if cell.tool_radius is None else [cell.tool_radius]
    return np.array([*cell.radii(robot)[[line.link for line in lines[:-1]]], *tool])


def _capsules(
    cell: Cell, robot: Robot, at: Skeleton, lines: Sequence[Line]
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Yield start, end (n, 3) and radius of the capsules about some lines of a skeleton, and of the bars."""
    for line, radius in zip(lines, _radii(cell, robot, at.lines), strict=False):
        yield at.nodes[:, line.start], at.nodes[:, line.end], radius
    for k in range(max(0, at.bars.shape[1] - 1)):
        yield at.bars[:, k], at.bars[:, k + 1], cell.radii(robot).min()


def _base_pose(robot: Robot) -> np.ndarray:
    return placement_matrix([*robot.base.origin, *robot.base.rotation])


def _in_drawing(cell: Cell, robot: Robot, points: np.ndarray) -> np.ndarray:
    stands = _base_pose(robot)
    return points if cell.frame == "base" else points @ stands[:3, :3].T + stands[:3, 3]


def _stations(cell: Cell, robot: Robot) -> Iterator[tuple[CellStation, np.ndarray]]:
    stands = _base_pose(robot)
    for station in cell.stations:
        yield station, (np.array(station.origin) - stands[:3, 3]) @ stands[:3, :3]


def lines_of_sight(
    cell: Cell, robot: Robot, point: ca.SX, flange: ca.SX
) -> Iterator[tuple[str, ca.SX, tuple[float, float]]]:
    """Yield rule, expression [m, sine or cosine] and bounds of each line of sight from point on flange (3, 3), in base frame."""
    axis = flange @ ca.DM(cell.reflector_axis) / np.linalg.norm(cell.reflector_axis)
    for station, place in _stations(cell, robot):
        way = ca.DM(place) - point
        distance = ca.norm_2(way)
        elevations = np.clip([station.elevation_min, station.elevation_max], -np.pi / 2, np.pi / 2)
        yield RANGE, distance, (station.range_min, station.far)
        yield ELEVATION, -ca.dot(ca.DM(_base_pose(robot)[2, :3]), way) / distance, tuple(np.sin(elevations))
        if cell.acceptance is not None:
            yield ACCEPTANCE, ca.dot(axis, way) / distance, (np.cos(cell.acceptance), np.inf)


def _obstacles(cell: Cell, start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the distances (n,) of segments from each drawn body except the floor, in the drawing's frame."""
    for box in cell.boxes:
        yield box_distances(start, end, np.array(box.min), np.array(box.max))
    for cylinder in cell.cylinders:
        ends = (np.broadcast_to(np.array(place), start.shape) for place in (cylinder.start, cylinder.end))
        yield segment_distances(start, end, *ends) - cylinder.radius


def _same_configuration(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    if cell.configuration is not None:
        readings = np.zeros((1, model.robot.n_joints))
        readings[:, model.robot.arm] = cell.configuration
        kept = configuration(model.robot, Skeleton.of(model.robot, readings, next(iter(model.robot.markers))))
        yield (configuration(model.robot, at) == kept).all(axis=1)


def _torques_allowed(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    if cell.torque_share is not None:
        rigid = Model(model.robot, (), model.given)
        (torque,) = rigid.figures("torque", lambda p, c, at: [at.state.torque], rigid.nominal, conditions)
        rated = [np.inf if joint.rated_torque is None else joint.rated_torque for joint in model.robot.joints]
        yield (np.abs(torque[:, :, 0]) <= cell.torque_share * np.array(rated)).all(axis=1)


def _seen(rule: str, cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    nothing, point, flange = ca.SX.sym("p", 0), ca.SX.sym("point", 3), ca.SX.sym("flange", 3, 3)
    for name, value, (least, most) in lines_of_sight(cell, model.robot, point, flange):
        if name == rule:
            sight = ca.Function("sight", [nothing, point, flange], [ca.densify(value)])
            ((values,),) = over_rows(sight, np.zeros(0), at.marker.T, at.flange.transpose(2, 1, 0).reshape(9, -1))
            yield (values >= least) & (values <= most)


def _no_self_collision(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    radii = _radii(cell, model.robot, at.lines)
    for i, j in checked_pairs(cell, model.robot, at.lines) if cell.self_collision else ():
        apart = segment_distances(*(at.nodes[:, node] for k in (i, j) for node in at.lines[k][:2]))
        yield apart > radii[i] + radii[j] + cell.clearance


def _clear_of_obstacles(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    robot = model.robot
    standing = standing_lines(robot, at.lines)
    for k, (start, end, radius) in enumerate(_capsules(cell, robot, at, at.lines)):
        if k not in standing:
            a, b = _in_drawing(cell, robot, start), _in_drawing(cell, robot, end)
            if cell.floor is not None:
                yield np.minimum(a[:, 2], b[:, 2]) > cell.floor + radius + cell.clearance
            yield from (distance > radius + cell.clearance for distance in _obstacles(cell, a, b))


def _unobstructed(cell: Cell, model: Model, conditions: np.ndarray, at: Skeleton) -> Iterator[np.ndarray]:
    for _, place in _stations(cell, model.robot) if cell.line_of_sight else ():
        way = place - at.marker
        length = np.linalg.norm(way, axis=1, keepdims=True).clip(1e-12)
        start, end = at.marker + way * np.minimum(1, cell.sight_from / length), at.marker + way
        for a, b, radius in _capsules(cell, model.robot, at, at.lines[:-1]):
            yield segment_distances(start, end, a, b) > radius
        drawn = (_in_drawing(cell, model.robot, point) for point in (start, end))
        yield from (distance > TOUCHING for distance in _obstacles(cell, *drawn))


RULES: Mapping[str, Callable[[Cell, Model, np.ndarray, Skeleton], Iterator[np.ndarray]]] = {
    "another configuration": _same_configuration,
    "payload": _torques_allowed,
    **{rule: partial(_seen, rule) for rule in (RANGE, ELEVATION, ACCEPTANCE)},
    "links that touch each other": _no_self_collision,
    "floor, boxes or cylinders": _clear_of_obstacles,
    "line of sight": _unobstructed,
}  # in the order of evaluation; each yields, for every body that it checks, which poses are allowed, (n,)
