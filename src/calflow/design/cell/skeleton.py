"""The skeleton: where a robot's joints, flange, bars and marker are at many poses, by its nominal figures."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Self

import casadi as ca
import numpy as np

from calflow.model import over_rows
from calflow.robot.chain import Deflection, pose
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.robot import Robot
from calflow.robot.transforms import apply


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Points [m] and directions at n poses, in the base's frame as the link on the floor sees it.

    nodes (n, n_joints + 2, 3) are the base's origin, each joint's and the flange's: link k goes from node k to the next. axes
    (n, n_joints, 3) are the joints' axes, flange (n, 3, 3) turns the flange's, marker (n, 3) is the reflector, bars (n, 3 or 0, 3)
    the pins P, Q and R of a loop.
    """

    nodes: np.ndarray
    axes: np.ndarray
    flange: np.ndarray
    marker: np.ndarray
    bars: np.ndarray

    @classmethod
    def of(cls, robot: Robot, readings: np.ndarray, marker: str) -> Self:
        """Return the skeletons at joint readings (n, n_joints) [rad, or m]."""
        points = _function(robot, marker)
        (found,) = over_rows(points, np.zeros(0), np.asarray(readings @ robot.reading_matrix.T).T)
        every = found.T.reshape(len(readings), -1, 3)
        n = robot.n_joints
        ends = np.cumsum([n + 2, n, 3, 1])
        nodes, axes, flange, own, bars = np.split(every, ends, axis=1)
        return cls(nodes, axes, np.swapaxes(flange, 1, 2), own[:, 0], bars)

    def part(self, which: np.ndarray) -> Self:
        """Return some of the poses: indices, or a mask (n,)."""
        return type(self)(*(getattr(self, field.name)[which] for field in fields(self)))


@lru_cache(maxsize=16)
def link_lengths(robot: Robot) -> np.ndarray:
    """Return the largest length [m] of each link, from the base's to the last one's, shape (n_joints + 1,)."""
    ends = Skeleton.of(robot, robot.limits.T @ robot.angle_matrix.T, next(iter(robot.markers)))
    return np.asarray(np.linalg.norm(np.diff(ends.nodes, axis=1), axis=2).max(axis=0))


def reflector(robot: Robot, marker: str, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the expressions of the marker (3,) and of the flange's turn (3, 3) at driven joint angles q (n_joints,)."""
    found = _function(robot, marker)(ca.SX(0, 1), q)
    turn = 3 * (2 * robot.n_joints + 2)
    return found[turn + 9 : turn + 12], ca.reshape(found[turn : turn + 9], 3, 3)


@lru_cache(maxsize=16)
def _function(robot: Robot, marker: str) -> ca.Function:
    """The function of driven joint angles that gives all points and directions, one after the other."""
    q = ca.SX.sym("q", robot.n_joints)
    at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints))
    stands = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
    reflector = apply(at.flange, ca.SX(ca.DM(robot.markers[marker].point)))
    bars = []
    if robot.loop:
        crank, rod = at.bars
        bars = [crank[:3, 3], rod[:3, 3], rod[:3, 3] + robot.loop.rod.length * rod[:3, 0]]
    places = [at.ends[0], *at.joints, at.flange]
    nodes = [at.grounded(robot, place[:3, 3]) for place in places]
    turned = [stands @ one for one in (*(joint[:3, 2] for joint in at.joints), *ca.horzsplit(at.flange[:3, :3]))]
    points = [at.grounded(robot, point) for point in (reflector, *bars)]
    return ca.Function("skeleton", [ca.SX.sym("p", 0), q], [ca.densify(ca.vertcat(*nodes, *turned, *points))])
