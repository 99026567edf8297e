"""The cell: who looks at the robot from where, what stands around it, and which poses it may take there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from calflow.design.cell.capsules import between_segments, from_box
from calflow.design.cell.skeleton import Skeleton, link_lengths
from calflow.model import Model, over_rows
from calflow.robot.parts import Vector
from calflow.robot.robot import Robot
from calflow.robot.transforms import placement

USUAL_RADIUS = 0.04  # of a link, in lengths of the stretched arm: what the library's robots have, about
TOUCHING = 1e-9  # m: a line through a thing is so near to it at most, by rounding
BLOCK = 8192  # poses at once: what a processor's cache holds


@dataclass(frozen=True)
class Station:
    """A device in the measuring frame [m]: how near and how far it measures [m], how low and how high about the frame's z [rad]."""

    origin: Vector
    near: float = 0.0
    far: float = np.inf
    lowest: float = -np.pi / 2
    highest: float = np.pi / 2


@dataclass(frozen=True)
class Box:
    """A box by its least and its largest corner [m]."""

    low: Vector
    high: Vector


@dataclass(frozen=True)
class Cylinder:
    """A cylinder by the ends of its axis and its radius [m]; its ends count as rounded, which makes it longer by its radius."""

    start: Vector
    end: Vector
    radius: float


@dataclass(frozen=True)
class Cell:
    """What a pose must keep to; SI units.

    Every station must see the reflector: at most `acceptance` off reflector_axis (in the flange's frame), and, where
    line_of_sight is asked for, past links, bars, boxes and cylinders; the first sight_from of a line do not count. Links are
    capsules of these radii, one a joint (the base has the first one's), and so are the tool, from flange to reflector, where
    tool_radius says so, and a loop's bars; all keep clearance. The drawing is in the base's frame or the measuring one. like are
    joint readings (n_joints,) whose elbow and wrist are kept, torque_share how much of each rated torque holding may take.
    """

    stations: tuple[Station, ...] = ()
    reflector_axis: Vector = (0.0, 0.0, 1.0)
    acceptance: float | None = None
    line_of_sight: bool = True
    sight_from: float = 0.0
    radii: tuple[float, ...] | None = None
    tool_radius: float | None = None
    self_collision: bool = True
    clearance: float = 0.0
    drawn_in_base: bool = True
    floor: float | None = None
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    like: tuple[float, ...] | None = None
    torque_share: float | None = None

    def refusals(self, model: Model, rows: np.ndarray, marker: str) -> np.ndarray:
        """Return which of RULES is the first to refuse each of packed rows (n_conditions, n), from 1; 0 where none does."""
        found = np.zeros(rows.shape[1], dtype=int)
        for begin in range(0, len(found), BLOCK):
            left = np.arange(begin, min(begin + BLOCK, len(found)))
            at = Skeleton.of(model.robot, rows[: model.robot.n_joints, left].T, marker)
            for number, rule in enumerate(RULES.values(), start=1):
                good = rule(self, model, rows[:, left], at)
                found[left[~good]] = number
                left, at = left[good], at.part(good)
        return found

    def link_radii(self, robot: Robot) -> np.ndarray:
        """Return the radius [m] of every link, the base's first, shape (n_joints + 1,)."""
        if self.radii is None:
            return np.full(robot.n_joints + 1, USUAL_RADIUS * link_lengths(robot).sum())
        return np.array([self.radii[0], *self.radii])


def refused_words(refusals: np.ndarray) -> str:
    """Say how many poses each rule refused, of whose first refusals (n,) these are, and how many none did."""
    counts = np.bincount(refusals, minlength=len(RULES) + 1)
    told = [f"{name} {number}" for name, number in zip(RULES, counts[1:], strict=True) if number]
    return f"the cell allows {counts[0]} of {len(refusals)} poses; refused by {', '.join(told) or 'nothing'}"


def configuration(robot: Robot, at: Skeleton) -> np.ndarray:
    """Return on which side of stretched elbow and wrist of a six-joint arm are, -1 or 1, shape (n, 2)."""
    arm = robot.arm
    upper, lower = at.nodes[:, arm[2] + 1] - at.nodes[:, arm[1] + 1], at.nodes[:, arm[4] + 1] - at.nodes[:, arm[2] + 1]
    elbow = (np.cross(upper, lower) * at.axes[:, arm[2]]).sum(axis=1)
    wrist = (np.cross(at.axes[:, arm[3]], at.axes[:, arm[5]]) * at.axes[:, arm[4]]).sum(axis=1)
    return np.sign(np.stack([elbow, wrist], axis=1))


def checked_pairs(cell: Cell, robot: Robot) -> list[tuple[int, int]]:
    """Return the pairs of capsules that may not touch: not neighbours, nor such as the links between never part by their radii."""
    lengths = link_lengths(robot)
    radii = _radii(cell, robot)
    return [
        (i, j)
        for i, j in combinations(range(len(radii)), 2)
        if lengths[i + 1 : j].sum() > radii[i] + radii[j] + cell.clearance
    ]


def free_links(robot: Robot) -> int:
    """Return the first link that does not stand where the robot stands: neither base nor rail nor what the first joint turns."""
    return robot.arm[0] + 2


def _radii(cell: Cell, robot: Robot) -> np.ndarray:
    """The radii of links and tool."""
    tool = [] if cell.tool_radius is None else [cell.tool_radius]
    return np.array([*cell.link_radii(robot), *tool])


def _chain(cell: Cell, at: Skeleton) -> np.ndarray:
    """The ends of the capsules of links and tool, (n, number + 1, 3)."""
    return at.nodes if cell.tool_radius is None else np.hstack([at.nodes, at.marker[:, None]])


def _capsules(
    cell: Cell, robot: Robot, chain: np.ndarray, bars: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Start, end (n, 3) and radius of each capsule of a chain of points, and of the bars."""
    for k, radius in enumerate(_radii(cell, robot)[: chain.shape[1] - 1]):
        yield chain[:, k], chain[:, k + 1], radius
    for k in range(max(0, bars.shape[1] - 1)):
        yield bars[:, k], bars[:, k + 1], cell.link_radii(robot).min()


def _stands(robot: Robot) -> np.ndarray:
    """The base in the measuring frame (4, 4)."""
    return np.array(ca.DM(ca.evalf(placement(ca.DM([*robot.base.origin, *robot.base.rotation])))))


def _drawn(cell: Cell, robot: Robot, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the base's frame in that of the drawing."""
    stands = _stands(robot)
    return points if cell.drawn_in_base else points @ stands[:3, :3].T + stands[:3, 3]


def _views(cell: Cell, robot: Robot, at: Skeleton) -> Iterator[tuple[Station, np.ndarray]]:
    """Each station, and the way (n, 3) from the reflector to it, in the base's frame."""
    stands = _stands(robot)
    for station in cell.stations:
        yield station, (np.array(station.origin) - stands[:3, 3]) @ stands[:3, :3] - at.marker


def _obstacles(cell: Cell, start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """The distances (n,) of segments from each thing drawn but the floor, in the drawing's frame."""
    for box in cell.boxes:
        yield from_box(start, end, np.array(box.low), np.array(box.high))
    for one in cell.cylinders:
        ends = (np.broadcast_to(np.array(place), start.shape) for place in (one.start, one.end))
        yield between_segments(start, end, *ends) - one.radius


def _like(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    if cell.like is None:
        return np.ones(len(at.marker), dtype=bool)
    kept = configuration(model.robot, Skeleton.of(model.robot, np.array([cell.like]), next(iter(model.robot.markers))))
    return np.asarray((configuration(model.robot, at) == kept).all(axis=1))


def _carried(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    if cell.torque_share is None:
        return np.ones(len(at.marker), dtype=bool)
    rigid = Model(model.robot, (), model.given)
    p, c, predicted = rigid.symbols
    torque = over_rows(ca.Function("torque", [p, c], [ca.densify(predicted.state.torque)]), rigid.nominal, rows)[0]
    rated = np.array([np.inf if joint.rated_torque is None else joint.rated_torque for joint in model.robot.joints])
    return np.asarray((np.abs(torque.T) <= cell.torque_share * rated).all(axis=1))


def _in_range(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    for station, way in _views(cell, model.robot, at):
        distance = np.linalg.norm(way, axis=1)
        good &= (distance >= station.near) & (distance <= station.far)
    return good


def _at_elevation(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    up = _stands(model.robot)[2, :3]
    for station, way in _views(cell, model.robot, at):
        elevation = np.arcsin(np.clip(-way @ up / np.linalg.norm(way, axis=1).clip(1e-12), -1, 1))
        good &= (elevation >= station.lowest) & (elevation <= station.highest)
    return good


def _accepted(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    if cell.acceptance is not None:
        axis = at.flange @ (np.array(cell.reflector_axis) / np.linalg.norm(cell.reflector_axis))
        for _, way in _views(cell, model.robot, at):
            good &= (axis * way).sum(axis=1) >= np.cos(cell.acceptance) * np.linalg.norm(way, axis=1)
    return good


def _apart(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    if cell.self_collision:
        chain, radii = _chain(cell, at), _radii(cell, model.robot)
        for i, j in checked_pairs(cell, model.robot):
            apart = between_segments(chain[:, i], chain[:, i + 1], chain[:, j], chain[:, j + 1])
            good &= apart > radii[i] + radii[j] + cell.clearance
    return good


def _clear(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    robot, first = model.robot, free_links(model.robot)
    for k, (start, end, radius) in enumerate(_capsules(cell, robot, _chain(cell, at), at.bars)):
        if k < first:
            continue
        a, b = _drawn(cell, robot, start), _drawn(cell, robot, end)
        if cell.floor is not None:
            good &= np.minimum(a[:, 2], b[:, 2]) > cell.floor + radius + cell.clearance
        for distance in _obstacles(cell, a, b):
            good &= distance > radius + cell.clearance
    return good


def _seen(cell: Cell, model: Model, rows: np.ndarray, at: Skeleton) -> np.ndarray:
    good = np.ones(len(at.marker), dtype=bool)
    for _, way in _views(cell, model.robot, at) if cell.line_of_sight else ():
        length = np.linalg.norm(way, axis=1, keepdims=True).clip(1e-12)
        start, end = at.marker + way * np.minimum(1, cell.sight_from / length), at.marker + way
        for a, b, radius in _capsules(cell, model.robot, at.nodes, at.bars):
            good &= between_segments(start, end, a, b) > radius
        drawn = (_drawn(cell, model.robot, point) for point in (start, end))
        for distance in _obstacles(cell, *drawn):
            good &= distance > TOUCHING
    return good


RULES: Mapping[str, Callable[[Cell, Model, np.ndarray, Skeleton], np.ndarray]] = {
    "another configuration": _like,
    "payload": _carried,
    "range": _in_range,
    "elevation": _at_elevation,
    "acceptance of the reflector": _accepted,
    "links that touch each other": _apart,
    "floor, boxes or cylinders": _clear,
    "line of sight": _seen,
}  # in the order in which they are asked; each says which poses it allows, (n,)
