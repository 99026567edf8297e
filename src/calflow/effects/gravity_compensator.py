"""Gravity compensator: a spring or gas cylinder that carries a part of the lower arm's torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words, joint_variable
from calflow.robot.chain import Deflection, pose
from calflow.robot.conditions import Row
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot
from calflow.robot.statics import State, rated_torques

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements

SD, BOUND = 0.3, 2.0  # times joint 2's rated torque
RATIOS = (0.2, 0.4)  # lever on the arm over the hinge's distance, of short cylinders
HINGES = (-90.0, 0.0, 90.0)  # deg from straight below the joint


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """Torque on joint 2 = (Tc cos q2 + Ts sin q2) / sqrt(1 + r² + 2 r cos(q2 - q0 - hinge)).

    A cylinder of constant force between a point of the arm and a hinge on the column has this lever: r is the point's
    distance from the joint over the hinge's (0: the hinge is far away), q0 where the arm stands upright, hinge [deg] the
    hinge's direction from straight below. It shows by the wind-up that it takes off the joint's compliance.
    """

    ratio: float = 0.0
    hinge: float = 0.0

    id: ClassVar[str] = "gravity-compensator"
    title: ClassVar[str] = "gravity compensator"
    words: ClassVar[Words] = Words(
        "gravity compensator torque", "a spring or gas cylinder carries a part of the arm's weight", "torque"
    )
    needs: ClassVar[tuple[str, ...]] = ("masses",)
    told_by: ClassVar[str] = "measure some poses again with the compensator's pressure released or its spring unhooked"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return a far hinge, and near ones below the joint and on either side."""
        return (cls(robot), *(cls(robot, ratio, hinge) for ratio in RATIOS for hinge in HINGES))

    @property
    def detail(self) -> str:
        """Say how long the cylinder is."""
        if not self.ratio:
            return "far hinge"
        side = f", {self.hinge:+.0f} deg from below" if self.hinge else " below"
        return f"hinge {1 / self.ratio:.3g} levers away{side}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the torque's two phases."""
        if not self._has_arm:
            return ()
        rated = float(rated_torques(self.robot)[1])
        return tuple(
            Parameter(self.id, "joint2", f"T{phase}", "Nm", SD * rated, -BOUND * rated, BOUND * rated,
                      meaning=f"compensator's torque, {wave} part", joint=2)
            for phase, wave in (("c", "cosine"), ("s", "sine"))
        )  # fmt: skip

    @property
    def _has_arm(self) -> bool:
        """Whether joint 2 turns an arm that a cylinder can carry."""
        return self.robot.n_joints > 1 and self.robot.joints[1].kind == "revolute"

    @cached_property
    def upright(self) -> float:
        """The angle of joint 2 [rad] at which the arm points against gravity, the others at zero."""
        robot = self.robot
        at = pose(robot, nominal_dimensions(robot), ca.SX(robot.n_joints, 1), Deflection.zero(robot.n_joints))
        frame, end = (np.array(ca.DM(ca.evalf(one))) for one in (at.joints[1], at.ends[2]))
        axis, arm, up = frame[:3, 2], end[:3, 3] - frame[:3, 3], -np.array(robot.gravity)
        across = up - axis * (axis @ up)
        return float(np.arctan2(axis @ np.cross(arm, across), arm @ across))

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add the cylinder's torque."""
        if not self._has_arm:
            return 0.0
        q = state.q[1]
        length = 1.0
        if self.ratio:
            angle = q - self.upright - np.deg2rad(self.hinge)
            length = ca.sqrt(1 + self.ratio**2 + 2 * self.ratio * ca.cos(angle))
        torque = ca.SX(self.robot.n_joints, 1)
        torque[1] = (p[0] * ca.cos(q) + p[1] * ca.sin(q)) / length
        return torque

    def variable(self, joint: int) -> Variable:
        """Return joint 2's angle."""
        return joint_variable(self.robot, 2)
