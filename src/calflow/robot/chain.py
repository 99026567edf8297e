"""The kinematic chain: where every joint, link end and marker is, small elastic motions of each included."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.robot.description import Robot
from calflow.robot.dimensions import Dimensions
from calflow.robot.loop import Closure, assembly_side, close
from calflow.robot.transforms import apply, placement, rot_x, rot_y, rot_z, translation


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
class Pose:
    """The frames of one pose, 4x4 each, in the robot's base frame.

    joints has each joint's frame after its rotation, ends each link's far end (ends[0] the base, the last the flange),
    links each link's own DH frame, bars the crank's and the rod's. closure is None without a loop.
    """

    joints: tuple[ca.SX, ...]
    ends: tuple[ca.SX, ...]
    links: tuple[ca.SX, ...]
    bars: tuple[ca.SX, ...]
    closure: Closure | None

    @property
    def flange(self) -> ca.SX:
        """The flange's frame."""
        return self.ends[-1]


def pose(robot: Robot, dims: Dimensions, q: ca.SX, deflection: Deflection) -> Pose:
    """Return all frames at driven joint angles q (n_joints,) [rad, or m].

    A modified-DH link is Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d) (Craig; equations 1 and 6 of the HH800 paper), a DH link
    Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). In both the joint's own frame is the one just after Rz.
    A loop is closed at the place to which its pin S has moved in the loop's plane.
    """
    driven = q + deflection.joint
    angles, closure = _chain_angles(robot, dims, driven, deflection)
    end = _twist(deflection.link[:, 0])
    joints: list[ca.SX] = []
    ends, links = [end], list[ca.SX]()
    bars: tuple[ca.SX, ...] = ()
    for i, joint in enumerate(robot.joints):
        before = end
        if robot.convention == "modified-dh":
            length = dims.a[0] if i == 0 else 0  # the base gives way at its origin
            before = end @ rot_x(dims.alpha[i]) @ translation(length, 0, 0) @ rot_y(dims.beta[i])
        if robot.loop and i == robot.loop.joint - 2 and closure:
            bars = _bar_frames(before, dims, driven[robot.loop.joint - 1], closure)
        slide = dims.d[i] + (angles[i] if joint.kind == "prismatic" else 0)
        turn = dims.theta[i] + (angles[i] if joint.kind == "revolute" else 0)
        moved = before @ rot_z(turn) @ _twist(deflection.bearing[:, i])
        frame = moved @ translation(0, 0, slide)
        if robot.convention == "dh":
            frame = frame @ translation(dims.a[i], 0, 0) @ rot_x(dims.alpha[i]) @ rot_y(dims.beta[i])
        end = frame
        if robot.convention == "modified-dh" and i + 1 < robot.n_joints:
            end = frame @ translation(dims.a[i + 1], 0, 0)
        end = end @ _twist(deflection.link[:, i + 1])
        joints.append(moved)
        links.append(frame)
        ends.append(end)
    return Pose(tuple(joints), tuple(ends), tuple(links), bars, closure)


def marker_point(dims: Dimensions, pose: Pose, choice: ca.SX) -> ca.SX:
    """Return the chosen marker's position in the robot's base frame; choice is one-hot over markers."""
    return apply(pose.flange, dims.markers @ choice)


def _chain_angles(
    robot: Robot, dims: Dimensions, driven: ca.SX, deflection: Deflection
) -> tuple[ca.SX, Closure | None]:
    """Joint variables along the chain from the driven ones: the loop turns its motor's angle into its joint's."""
    if robot.loop is None:
        return driven, None
    j = robot.loop.joint - 1
    turn = driven[j - 1] + dims.theta[j - 1]
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
    joint = _twist(deflection.bearing[:, i]) @ translation(0, 0, dims.d[i])
    bend = _twist(deflection.link[:, i + 1])
    if robot.convention == "modified-dh":
        return joint @ translation(dims.a[i + 1], 0, 0) @ bend
    turns, still = rot_x(dims.alpha[i]) @ rot_y(dims.beta[i]), ca.SX.eye(4)
    # The bend is in the turned axes. As a difference it leaves no operations where nothing bends.
    return joint @ translation(dims.a[i], 0, 0) @ (still + turns @ (bend - still) @ turns.T)


def _bar_frames(ground: ca.SX, dims: Dimensions, crank_angle: ca.SX, closure: Closure) -> tuple[ca.SX, ...]:
    crank = ground @ rot_z(crank_angle)
    rod = crank @ translation(dims.bars[0], 0, 0) @ rot_z(closure.rod_angle - crank_angle)
    return crank, rod


def _twist(small: ca.SX) -> ca.SX:
    return ca.SX.eye(4) if small.nnz() == 0 else placement(small)
