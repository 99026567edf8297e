"""The kinematic chain: where every joint, link end and marker is, small elastic motions of each included."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from calflow.robot.dimensions import Dimensions, nominal_dimensions, symbols_like
from calflow.robot.links import along, figures, span, to_axis, to_end
from calflow.robot.loop import Closure, assembly_side, close
from calflow.robot.robot import Robot
from calflow.robot.transforms import apply, placement, rot_z, translation


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
