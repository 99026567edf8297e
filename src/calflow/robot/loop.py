"""The four-bar loop PQRS: the driven joint's angle from the two motors', closed exactly for any lengths."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.links import span
from calflow.robot.parts import FourBar
from calflow.robot.robot import Robot
from calflow.robot.transforms import rot_z

DEAD_POINT = 0.97  # |cosine| of the closure from which a loop is too near its dead point to go there
WAY_POINTS = 21


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
    side; it is told in the middle of the two joints' ranges.
    """
    loop = robot.loop
    if loop is None:
        return 1
    link, crank = robot.joints[loop.joint - 2], robot.joints[loop.joint - 1]
    x, y = _pin(robot, loop)
    between = np.mean(crank.range) - np.mean(link.range) - link.frame.turn.value - np.arctan2(y, x)
    return (1 if np.sin(between) > 0 else -1) * (1 if loop.assembly == "open" else -1)


def reachable(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return which joint angles (n_poses, n_joints) a robot's loop can go to without passing a dead point.

    Every pose is approached in a straight line from the middle of the joints' ranges.
    """
    loop = robot.loop
    if loop is None or not len(q):
        return np.ones(len(q), dtype=bool)
    j = loop.joint - 1
    symbols = ca.SX.sym("link_angle"), ca.SX.sym("crank_angle")
    bars = ca.SX([loop.crank.length, loop.rod.length, loop.rocker])
    pin = rot_z(symbols[0])[:2, :2] @ ca.DM(_pin(robot, loop))
    cosine = ca.Function("cosine", symbols, [close(assembly_side(robot), pin, bars, symbols[1]).cosine])
    middle = robot.limits.mean(axis=1)
    ways = middle + np.linspace(0, 1, WAY_POINTS)[:, None, None] * (q - middle)
    angles = ways[..., j - 1].ravel() + robot.frames[j - 1].turn.value, ways[..., j].ravel()
    along = np.array(cosine.map(len(angles[0]))(*angles)).reshape(WAY_POINTS, len(q))
    return np.asarray((np.abs(along) < DEAD_POINT).all(axis=0))


def _pin(robot: Robot, loop: FourBar) -> np.ndarray:
    """Place (2,) of the pin S of the nominal robot in the loop's plane, from P, where the arm's joint has not turned."""
    end = span(robot, nominal_dimensions(robot), loop.joint - 2)
    return np.array(ca.DM(ca.evalf(end[:2, 3]))).ravel()


def close(side: int, pin: ca.SX, bars: ca.SX, crank_angle: ca.SX) -> Closure:
    """Solve the loop for its bar lengths, S's place (2,) in its plane and the crank's angle; side is `assembly_side`'s.

    With Q = crank e^{i·crank_angle} and D = S - Q, the rocker's direction e^{iφ} follows from |D + rocker e^{iφ}| = rod
    (equation 5 of Model based robot calibration, 2021, solved without its parallelogram assumption).
    """
    crank, rod, rocker = bars[0], bars[1], bars[2]
    dx = pin[0] - crank * ca.cos(crank_angle)
    dy = pin[1] - crank * ca.sin(crank_angle)
    squared = dx**2 + dy**2
    cosine = (rod**2 - squared - rocker**2) / (2 * rocker * ca.sqrt(squared))
    # Past the end of its travel the loop has no solution; the clamp keeps derivatives finite and `cosine` tells.
    reachable = ca.fmin(ca.fmax(cosine, -1 + 1e-9), 1 - 1e-9)
    rocker_angle = ca.atan2(dy, dx) + side * ca.acos(reachable)
    rod_angle = ca.atan2(dy + rocker * ca.sin(rocker_angle), dx + rocker * ca.cos(rocker_angle))
    return Closure(rocker_angle, rod_angle, cosine)
