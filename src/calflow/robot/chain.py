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
    frame, (6, n_joints); link the same at each link's far end, (6, n_joints + 1), where column 0 is the base and the last
    the flange. Units m and rad.
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
    """
    driven = q + deflection.joint
    angles, closure = _chain_angles(robot, dims, driven)
    end = _twist(deflection.link[:, 0])
    joints: list[ca.SX] = []
    ends, links = [end], list[ca.SX]()
    bars: tuple[ca.SX, ...] = ()
    for i, joint in enumerate(robot.joints):
        before = end
        if robot.convention == "modified-dh":
            before = end @ rot_x(dims.alpha[i]) @ translation(dims.a[i], 0, 0) @ rot_y(dims.beta[i])
        if robot.loop and i == robot.loop.joint - 2 and closure:
            bars = _bar_frames(before, dims, driven[robot.loop.joint - 1], closure)
        slide = dims.d[i] + (angles[i] if joint.kind == "prismatic" else 0)
        turn = dims.theta[i] + (angles[i] if joint.kind == "revolute" else 0)
        moved = before @ rot_z(turn) @ _twist(deflection.bearing[:, i])
        frame = moved @ translation(0, 0, slide)
        if robot.convention == "dh":
            frame = frame @ translation(dims.a[i], 0, 0) @ rot_x(dims.alpha[i]) @ rot_y(dims.beta[i])
        end = frame @ _twist(deflection.link[:, i + 1])
        joints.append(moved)
        links.append(frame)
        ends.append(end)
    return Pose(tuple(joints), tuple(ends), tuple(links), bars, closure)


def marker_point(dims: Dimensions, pose: Pose, choice: ca.SX) -> ca.SX:
    """Return the chosen marker's position in the robot's base frame; choice is one-hot over markers."""
    return apply(pose.flange, dims.markers @ choice)


def _chain_angles(robot: Robot, dims: Dimensions, driven: ca.SX) -> tuple[ca.SX, Closure | None]:
    """Joint variables along the chain from the driven ones: the loop turns its motor's angle into its joint's."""
    if robot.loop is None:
        return driven, None
    j = robot.loop.joint - 1
    link = dims.a[j] if robot.convention == "modified-dh" else dims.a[j - 1]
    link_angle = driven[j - 1] + dims.theta[j - 1]
    closure = close(assembly_side(robot), link, dims.bars, link_angle, driven[j])
    angles = ca.SX(driven)
    angles[j] = closure.rocker_angle - link_angle + robot.loop.offset
    return angles, closure


def _bar_frames(ground: ca.SX, dims: Dimensions, crank_angle: ca.SX, closure: Closure) -> tuple[ca.SX, ...]:
    crank = ground @ rot_z(crank_angle)
    rod = crank @ translation(dims.bars[0], 0, 0) @ rot_z(closure.rod_angle - crank_angle)
    return crank, rod


def _twist(small: ca.SX) -> ca.SX:
    return ca.SX.eye(4) if small.nnz() == 0 else placement(small)
