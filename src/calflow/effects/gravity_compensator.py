"""Gravity compensator: a spring or gas cylinder that carries a part of the lower arm's torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from calflow.conditions import Row
from calflow.effects.base import Effect, Parameter, Variable
from calflow.robot.statics import State, rated_torques

FIRST_SD, SECOND_SD, BOUND = 0.3, 0.05, 2.0  # times joint 2's rated torque, of the torque's two orders


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """Torque on joint 2 = T1c cos q2 + T1s sin q2 + T2c cos 2 q2 + T2s sin 2 q2.

    A cylinder between a point of the column and one of the arm, r from the axis, the other much further, pulls with a
    lever that is a sine of q2; the second order is what the finite distance leaves. It shows by the wind-up that it
    takes off the joint's compliance.
    """

    id: ClassVar[str] = "gravity-compensator"
    title: ClassVar[str] = "gravity compensator"
    needs: ClassVar[tuple[str, ...]] = ("masses",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the torque's two orders."""
        if self.robot.n_joints < 2:
            return ()
        rated = float(rated_torques(self.robot)[1])
        return tuple(
            Parameter(self.id, "joint2", f"T{order}{phase}", "Nm", sd * rated, -BOUND * rated, BOUND * rated,
                      meaning=f"compensator's torque, order {order}", joint=2)
            for order, sd in ((1, FIRST_SD), (2, SECOND_SD)) for phase in "cs"
        )  # fmt: skip

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add the cylinder's torque."""
        if self.robot.n_joints < 2:
            return 0.0
        q = state.q[1]
        torque = ca.SX(self.robot.n_joints, 1)
        torque[1] = ca.dot(p, ca.vertcat(ca.cos(q), ca.sin(q), ca.cos(2 * q), ca.sin(2 * q)))
        return torque

    def variable(self, joint: int) -> Variable:
        """Return joint 2's angle."""
        return Variable("angle of joint 2", "deg", lambda state, row: state.q[1], float(np.rad2deg(1.0)))
