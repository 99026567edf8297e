"""Posture: how an arm of six joints stands, read off the nominal robot's axes."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.deployment.programs.configuration import Posture
from calflow.robot.chain import Deflection, pose
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.robot import Robot

APART = 1e-3  # m: axes 4 and 5 that pass each other by less meet in a wrist
PARALLEL = 1e-6


@dataclass(frozen=True)
class Arm:
    """The axes of a robot by joint angles, and where its wrist points when all readings are 0; None where it has no such arm."""

    robot: Robot
    axes: ca.Function
    forward: np.ndarray | None

    @staticmethod
    def of(robot: Robot) -> Arm:
        """Return a robot's arm; one of six revolute joints whose last three axes meet has a posture."""
        q = ca.SX.sym("q", robot.n_joints)
        at = pose(robot, nominal_dimensions(robot), q, Deflection.zero(robot.n_joints))
        floor = at.links[robot.ground - 1][:3, :3].T if robot.ground else ca.SX.eye(3)
        own = [floor @ at.joints[i][:3, 2:4] for i in robot.arm]
        arm = Arm(robot, ca.Function("axes", [q], [ca.densify(ca.horzcat(*own))]), None)
        if len(robot.arm) != 6 or any(robot.joints[i].kind != "revolute" for i in robot.arm):
            return arm
        directions, points = arm.at(np.zeros(robot.n_joints))
        wrist = _meeting(directions[3:], points[3:])
        if wrist is None:
            return arm
        out = wrist - points[0]
        return Arm(robot, arm.axes, out - directions[0] * (directions[0] @ out))

    def at(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions (n, 3) of the arm's axes and a point (n, 3) [m] on each, in axes that stand on the floor.

        External axes move all of the arm: it stands as it would where they are at 0.
        """
        own = np.array(readings, dtype=float)
        own[self.robot.external] = 0.0
        found = np.array(self.axes(self.robot.reading_matrix @ own)).reshape(3, -1, 2)
        return found[:, :, 0].T, found[:, :, 1].T

    def posture(self, readings: np.ndarray) -> Posture:
        """Return how the arm stands."""
        angles = tuple(float(one) for one in readings[self.robot.arm])
        if self.forward is None or np.linalg.norm(self.forward) < APART:
            return Posture(angles, None, None)
        directions, points = self.at(readings)
        wrist = _meeting(directions[3:], points[3:])
        assert wrist is not None
        forward = _turned(self.forward, directions[0], self.robot.reading_matrix[self.robot.arm[0]] @ readings)
        up = directions[0] * (1 if directions[0][2] >= 0 else -1)
        side = np.cross(up, forward)
        upper = points[2] - points[1]
        upper -= directions[1] * (directions[1] @ upper)
        front = bool((wrist - points[0]) @ forward > 0)
        elbow = bool(side @ np.cross(upper, wrist - points[2]) > 0)
        return Posture(angles, front, elbow)


def _meeting(directions: np.ndarray, points: np.ndarray) -> np.ndarray | None:
    """The point in which three axes meet; None where they do not."""
    across = np.cross(directions[0], directions[1])
    if np.linalg.norm(across) < PARALLEL:  # of a stretched wrist: the axes before and after it are one line
        across = np.cross(directions[1], [1.0, 0.3, 0.1])
    apart = np.eye(3) * 3 - sum(np.outer(one, one) for one in directions)
    right = sum((np.eye(3) - np.outer(one, one)) @ point for one, point in zip(directions, points, strict=True))
    meeting = np.linalg.lstsq(apart, right, rcond=None)[0]
    off = [np.linalg.norm(np.cross(one, meeting - point)) for one, point in zip(directions, points, strict=True)]
    return np.asarray(meeting) if max(off) < APART else None


def _turned(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    return np.asarray(
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )
