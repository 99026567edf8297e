"""The kinematic chain: where every joint, link end and marker is, small elastic motions of each included.

A four-bar loop PQRS turns two motors' angles into its driven joint's; it is closed exactly for any lengths.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from calflow.robot.dimensions import Dimensions, nominal_dimensions, symbols_like
from calflow.robot.frames import Step
from calflow.robot.parts import FourBar
from calflow.robot.robot import Robot
from calflow.robot.transforms import apply, elementary, placement, rot_z, translation

Figures = Mapping[str, ca.SX]


def figures(robot: Robot, dims: Dimensions, joint: int) -> dict[str, ca.SX]:
    """Return the values of a joint's steps (its index from 0) by symbol [rad and m]."""
    return {step.symbol: dims.steps[robot.step_index(joint, step.symbol)] for step in robot.frames[joint].steps}


def along(at: ca.SX, steps: Iterable[Step], values: Figures) -> ca.SX:
    """Return the frame (4, 4) to which steps lead from a frame."""
    for step in steps:
        at = at @ elementary(step.motion, values[step.symbol])
    return at


def to_axis(at: ca.SX, robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the frame on a joint's axis, before it turns, from that at the end of the link before (the base's for joint 0)."""
    frame = robot.frames[joint]
    return along(at, frame.mount if joint else (*frame.reach, *frame.mount), figures(robot, dims, joint))


def to_end(at: ca.SX, robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the frame at the end of a joint's link, from the link's own."""
    following = joint + 1
    if following == robot.n_joints:
        return at
    return along(at, robot.frames[following].reach, figures(robot, dims, following))


def span(robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the transform (4, 4) from a joint's axis to the end of its link; that of a slide at zero."""
    link = along(ca.SX.eye(4), robot.frames[joint].body, figures(robot, dims, joint))
    return to_end(link, robot, dims, joint)


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


@dataclass(frozen=True)
class Deflection:
    """Small motions that load or wear adds to the nominal mechanism.

    joint is added to the driven joint angles, (n_joints,). bearing holds a twist (dx, dy, dz, rx, ry, rz) at each joint's
    frame, (6, n_joints); link the same at each link's far end, where the next joint is, (6, n_joints + 1), where column 0 is
    the base and the last the flange. Units m and rad.
    """

    joint: ca.SX
    bearing: ca.SX
    link: ca.SX

    @staticmethod
    def zero(n_joints: int) -> Deflection:
        """No motion at all."""
        return Deflection(ca.SX(n_joints, 1), ca.SX(6, n_joints), ca.SX(6, n_joints + 1))

    @property
    def is_zero(self) -> bool:
        """Whether no entry can differ from zero."""
        return all(part.nnz() == 0 for part in (self.joint, self.bearing, self.link))

    def __add__(self, other: Deflection) -> Deflection:
        return Deflection(self.joint + other.joint, self.bearing + other.bearing, self.link + other.link)


@dataclass(frozen=True)
class Posture:
    """The frames of one pose, 4x4 each, in the robot's base frame.

    joints has each joint's frame after its rotation, ends each link's far end (ends[0] the base, the last the flange),
    links each link's own frame, bars the crank's and the rod's. closure is None without a loop.
    """

    joints: tuple[ca.SX, ...]
    ends: tuple[ca.SX, ...]
    links: tuple[ca.SX, ...]
    bars: tuple[ca.SX, ...]
    closure: Closure | None

    def grounded(self, robot: Robot, point: ca.SX) -> ca.SX:
        """Return a point (3,) of the base's frame as the link that stands on the floor sees it."""
        if not robot.ground:
            return point
        floor = self.links[robot.ground - 1]
        return floor[:3, :3].T @ (point - floor[:3, 3])

    def down(self, robot: Robot) -> ca.SX:
        """Return gravity's direction in the base's frame, (3,)."""
        if not robot.ground:
            return ca.SX(ca.DM(robot.down))
        return self.links[robot.ground - 1][:3, :3] @ ca.DM(robot.down)

    @property
    def flange(self) -> ca.SX:
        """The flange's frame."""
        return self.ends[-1]


def pose(robot: Robot, dims: Dimensions, q: ca.SX, deflection: Deflection) -> Posture:
    """Return all frames at driven joint angles q (n_joints,) [rad, or m].

    A joint's own frame is the one just after it has turned about its axis (see `frames.Frame`).
    A loop is closed at the place to which its pin S has moved in the loop's plane.
    """
    found = [ca.sparsify(one) for one in _graph(robot)(*vars(dims).values(), q, *vars(deflection).values())]
    n = robot.n_joints
    joints, ends, links, rest = found[:n], found[n : 2 * n + 1], found[2 * n + 1 : 3 * n + 1], found[3 * n + 1 :]
    closure = Closure(*rest[2:]) if robot.loop else None
    return Posture(tuple(joints), tuple(ends), tuple(links), tuple(rest[:2]), closure)


@lru_cache(maxsize=16)
def _graph(robot: Robot) -> ca.Function:
    """Return the function of (dimensions, q, deflection) that gives all frames: calling it takes a tenth of building them."""
    dims, still = symbols_like(nominal_dimensions(robot)), symbols_like(Deflection.zero(robot.n_joints))
    q = ca.SX.sym("q", robot.n_joints)
    at = _frames(robot, dims, q, still)
    frames = (*at.joints, *at.ends, *at.links, *at.bars)
    closure = vars(at.closure).values() if at.closure else ()
    return ca.Function("pose", [*vars(dims).values(), q, *vars(still).values()], [*frames, *closure])


def _frames(robot: Robot, dims: Dimensions, q: ca.SX, deflection: Deflection) -> Posture:
    """The frames as `pose` has them, built step by step."""
    driven = q + deflection.joint
    angles, closure = _chain_angles(robot, dims, driven, deflection)
    end = _twist(deflection.link[:, 0])
    joints: list[ca.SX] = []
    ends, links = [end], list[ca.SX]()
    bars: tuple[ca.SX, ...] = ()
    for i, joint in enumerate(robot.joints):
        before = to_axis(end, robot, dims, i)
        if robot.loop and i == robot.loop.joint - 2 and closure:
            bars = _bar_frames(before, dims, driven[robot.loop.joint - 1], closure)
        values, frame = figures(robot, dims, i), joint.frame
        moving = frame.turn if joint.kind == "revolute" else frame.slide
        if moving:
            values[moving.symbol] += angles[i]
        moved = along(before, (frame.turn,), values) @ _twist(deflection.bearing[:, i])
        link = along(moved, frame.body, values)
        end = to_end(link, robot, dims, i) @ _twist(deflection.link[:, i + 1])
        joints.append(moved)
        links.append(link)
        ends.append(end)
    return Posture(tuple(joints), tuple(ends), tuple(links), bars, closure)


def marker_point(dims: Dimensions, pose: Posture, choice: ca.SX) -> ca.SX:
    """Return the chosen marker's position in the robot's base frame; choice is one-hot over markers."""
    return apply(pose.flange, dims.markers @ choice)


def _chain_angles(
    robot: Robot, dims: Dimensions, driven: ca.SX, deflection: Deflection
) -> tuple[ca.SX, Closure | None]:
    """Joint variables along the chain from the driven ones: the loop turns its motor's angle into its joint's."""
    if robot.loop is None:
        return driven, None
    j = robot.loop.joint - 1
    turn = driven[j - 1] + figures(robot, dims, j - 1)[robot.frames[j - 1].turn.symbol]
    arm = _arm(robot, dims, deflection, j - 1)
    pin = (rot_z(turn) @ arm)[:2, 3]
    closure = close(assembly_side(robot), pin, dims.bars, driven[j])
    # The rod holds the rocker in its plane: a slope of the arm at S does not turn it.
    slope = ca.atan2(arm[1, 0], arm[0, 0])
    angles = ca.SX(driven)
    angles[j] = closure.rocker_angle - (turn + slope) + robot.loop.offset
    return angles, closure


def _arm(robot: Robot, dims: Dimensions, deflection: Deflection, i: int) -> ca.SX:
    """Frame at S with x along the arm PS, which is link i, seen from the arm's joint before its bearing gives way."""
    end, still = span(robot, dims, i), ca.SX.eye(4)
    turns, bend = ca.SX(still), _twist(deflection.link[:, i + 1])
    turns[:3, :3] = end[:3, :3]
    # The bend is in the end's axes. As a difference it leaves no operations where nothing bends.
    straight = _twist(deflection.bearing[:, i]) @ translation(*ca.vertsplit(end[:3, 3]))
    return straight @ (still + turns @ (bend - still) @ turns.T)


def _bar_frames(ground: ca.SX, dims: Dimensions, crank_angle: ca.SX, closure: Closure) -> tuple[ca.SX, ...]:
    crank = ground @ rot_z(crank_angle)
    rod = crank @ translation(dims.bars[0], 0, 0) @ rot_z(closure.rod_angle - crank_angle)
    return crank, rod


def _twist(small: ca.SX) -> ca.SX:
    return ca.SX.eye(4) if small.nnz() == 0 else placement(small)
