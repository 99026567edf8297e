"""The skeleton: positions of a robot's joints, flange, bars and marker at many poses, and distances between capsules and boxes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple, Self

import casadi as ca
import numpy as np

from calflow.model import over_rows
from calflow.robot.frames import apply
from calflow.robot.mechanism import nominal_posture
from calflow.robot.robot import Robot

SHORT = 1e-18  # m² (m⁴): a squared length, or squared cross product of two segments, below which it is zero


def segment_distances(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances [m] (n,) of segments a to b from c to d, (n, 3) each (Ericson, Real-Time Collision Detection, 5.1.9)."""
    first, second, apart = b - a, d - c, a - c
    p, q, mixed = _dot(first, first), _dot(second, second), _dot(first, second)
    along, across = _dot(first, apart), _dot(second, apart)
    s = np.clip(_quotient(mixed * across - along * q, p * q - mixed**2), 0, 1)
    t = np.clip(_quotient(mixed * s + across, q), 0, 1)
    s = np.clip(_quotient(mixed * t - along, p), 0, 1)
    return np.linalg.norm(apart + s[:, None] * first - t[:, None] * second, axis=1)


def box_distances(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the distances [m] of segments from a to b, each (n, 3), from a box with these corners (3,), shape (n,).

    The squared distance along a segment is convex, and its derivative is linear between the segment's intersections
    with the box's six planes, so that its zero is found exactly.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    start, way = a - middle, b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = np.hstack([(half - start) / way, (-half - start) / way])
    ends = np.tile([0.0, 1.0], (len(a), 1))
    at = np.sort(np.hstack([np.clip(np.nan_to_num(passed), 0, 1), ends]), axis=1)
    points = start[:, None] + at[..., None] * way[:, None]
    slope = _dot(points - np.clip(points, -half, half), way[:, None])
    after = (slope < 0).sum(axis=1).clip(1, at.shape[1] - 1)[:, None]  # where the distance stops falling
    (t0, t1), (s0, s1) = ([np.take_along_axis(of, k, axis=1)[:, 0] for k in (after - 1, after)] for of in (at, slope))
    nearest = start + (t0 + (t1 - t0) * np.clip(_quotient(-s0, s1 - s0), 0, 1))[:, None] * way
    return np.linalg.norm(nearest - np.clip(nearest, -half, half), axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((a * b).sum(axis=-1))


def _quotient(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    return np.divide(part, whole, out=np.zeros_like(part), where=np.abs(whole) > SHORT)


class Line(NamedTuple):
    """A line of a skeleton from node start to node end, of a link; way: the lines from the base to its end."""

    start: int
    end: int
    link: int
    way: tuple[int, ...]


@lru_cache(maxsize=16)
def skeleton_lines(robot: Robot, flange: int) -> tuple[Line, ...]:
    """Return the lines of a skeleton: to each joint from its parent joint, to each tip, and from flange to reflector."""
    n, ways = robot.n_joints, [tuple(robot.chain(link)) for link in range(robot.n_joints + 1)]
    inner = [Line(on, i + 1, on, (*ways[on], i)) for i, on in enumerate(robot.parents)]
    tips = [Line(tip, k + 1, tip, (*ways[tip], k)) for k, tip in enumerate(robot.tips, start=n)]
    foot = n + len(robot.tips)
    before = next((tip.way for tip in tips if tip.link == flange), ways[flange])
    return (*inner, *tips, Line(foot + 1, foot + 2, flange, (*before, foot)))


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Points [m] and directions at n poses, in the base frame, fixed to the link on the floor.

    nodes (n, n_joints + n_tips + 3, 3): origins of base, joints, tips and flange (the link of the reflector), and the
    reflector; lines: their connections; axes (n, n_joints, 3): joint axes; flange (n, 3, 3): its orientation; bars
    (n, 3 or 0, 3): pins P, Q and R of a loop.
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
        points, lines = _function(robot, marker), skeleton_lines(robot, robot.link(robot.markers[marker].on))
        every = over_rows(points, np.zeros(0), np.asarray(readings @ robot.reading_matrix.T).T)
        shapes = [(len(readings), points.size2_out(k), 3) for k in range(len(every))]
        nodes, axes, flange, bars = (part.T.reshape(shape) for part, shape in zip(every, shapes, strict=True))
        return cls(lines, nodes, axes, flange.transpose(0, 2, 1), bars)

    def part(self, which: np.ndarray) -> Self:
        """Return the skeletons of a subset of poses, given by indices or a mask (n,)."""
        return type(self)(self.lines, *(getattr(self, field.name)[which] for field in fields(self)[1:]))


@lru_cache(maxsize=16)
def line_lengths(robot: Robot) -> np.ndarray:
    """Return the largest length [m] of each line but the last, from flange to reflector, shape (n_joints + n_tips,)."""
    at = Skeleton.of(robot, robot.limits.T @ robot.angle_matrix.T, next(iter(robot.markers)))
    start, end = ([getattr(line, name) for line in at.lines[:-1]] for name in ("start", "end"))
    return np.asarray(np.linalg.norm(at.nodes[:, end] - at.nodes[:, start], axis=2).max(axis=0))


def reflector(robot: Robot, marker: str, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the expressions of the marker (3,) and its flange's orientation (3, 3) at driven joint angles q (n_joints,)."""
    nodes, _, flange, _ = _function(robot, marker)(ca.SX(0, 1), q)
    return nodes[:, -1], flange


@lru_cache(maxsize=16)
def _function(robot: Robot, marker: str) -> ca.Function:
    """Return the function from driven joint angles to nodes (3, n_nodes), axes (3, n_joints), flange (3, 3), bars (3, 3 or 0)."""
    q = ca.SX.sym("q", robot.n_joints)
    at = nominal_posture(robot, q)
    stands = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
    flange = at.frame(robot, robot.link(robot.markers[marker].on))
    reflector = apply(flange, ca.SX(ca.DM(robot.markers[marker].point)))
    bars = []
    if robot.loop:
        crank, rod = at.bars
        bars = [crank[:3, 3], rod[:3, 3], rod[:3, 3] + robot.loop.rod.length * rod[:3, 0]]
    places = [at.ends[0], *at.joints, *(at.frame(robot, tip) for tip in robot.tips), flange]
    nodes = [at.grounded(robot, point) for point in (*(place[:3, 3] for place in places), reflector)]
    axes = [stands @ joint[:3, 2] for joint in at.joints]
    pins = [ca.SX(3, 0), *(at.grounded(robot, point) for point in bars)]
    every = (ca.horzcat(*nodes), ca.horzcat(*axes), stands @ flange[:3, :3], ca.horzcat(*pins))
    return ca.Function("skeleton", [ca.SX.sym("p", 0), q], [ca.densify(part) for part in every])
