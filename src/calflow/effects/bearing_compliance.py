"""Bearing compliance: joints that tilt off their axes under the moments they carry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from calflow.effects.base import Effect, Variable, Words
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.parameter import Parameter
from calflow.robot.statics import State, rated_torques

TILT_SD, TILT_BOUND = 2e-3, 20e-3  # rad at the largest rated torque of all joints


@dataclass(frozen=True)
class BearingCompliance(Effect):
    """A turn by (cx Mx, cy My) at the joint's frame, M the moment of all that the joint carries."""

    id: ClassVar[str] = "bearing-compliance"
    title: ClassVar[str] = "bearing compliance (tilt off the joint's axis)"
    words: ClassVar[Words] = Words("bearing tilt", "the bearing tilts across the joint's axis under load", "compliance")
    needs: ClassVar[tuple[str, ...]] = ("masses",)
    told_by: ClassVar[str] = "watch a marker close behind the bearing while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return two compliances a joint."""
        largest = float(rated_torques(self.robot).max())
        return tuple(
            Parameter(self.id, f"joint{i + 1}", symbol, "rad/Nm", TILT_SD / largest, 0.0, TILT_BOUND / largest,
                      meaning=f"bearing compliance of joint {i + 1} about {symbol[1]}", joint=i + 1)
            for i in range(self.robot.n_joints) for symbol in ("cx", "cy")
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Tilt each bearing."""
        bearing = ca.SX(still.bearing)
        bearing[3:5, :] = ca.reshape(p, 2, self.robot.n_joints) * state.bearing[3:5, :]
        return replace(still, bearing=bearing)

    def variable(self, joint: int) -> Variable:
        """Return the moment across the joint's axis."""
        moment = lambda state, row: ca.norm_2(state.bearing[3:5, joint - 1])  # noqa: E731
        return Variable(f"moment across the axis of joint {joint}", "Nm", moment)
