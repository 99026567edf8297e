"""Base compliance: a foundation that tilts under the robot's overturning moment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from calflow.conditions import Row
from calflow.effects.base import Effect, Parameter, Variable
from calflow.robot.chain import Deflection
from calflow.robot.statics import State, rated_torques

TILT_SD, TILT_BOUND = 0.5e-3, 10e-3  # rad at the largest rated torque of all joints


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """A tilt by c (Mx, My) at the base, M the overturning moment."""

    id: ClassVar[str] = "base-compliance"
    title: ClassVar[str] = "base compliance (tilt of the foundation)"
    needs: ClassVar[tuple[str, ...]] = ("masses",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliance."""
        largest = float(rated_torques(self.robot).max())
        return (
            Parameter(self.id, "base", "c", "rad/Nm", TILT_SD / largest, 0.0, TILT_BOUND / largest,
                      meaning="tilt of the base per overturning moment"),
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Tilt the base."""
        link = ca.SX(still.link)
        link[3:5, 0] = p * state.link[3:5, 0]
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the overturning moment."""
        return Variable("overturning moment", "Nm", lambda state, row: ca.norm_2(state.link[3:5, 0]))
