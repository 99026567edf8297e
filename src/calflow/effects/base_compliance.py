"""Base compliance: a foundation that tilts under the robot's overturning moment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca

from calflow.effects.base import Effect, Variable, Words
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

TILT_SD, TILT_BOUND = 0.5e-3, 10e-3  # rad at the largest rated torque of all joints


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """A tilt by C (Mx, My) at the base, M the overturning moment; C alike in all directions, or a symmetric matrix."""

    directions: int = 1

    id: ClassVar[str] = "base-compliance"
    title: ClassVar[str] = "base compliance (tilt of the foundation)"
    words: ClassVar[Words] = Words(
        "tilt of the base", "the base or its foundation tilts under the overturning moment", "compliance"
    )
    whole: ClassVar[str] = "base"
    needs: ClassVar[tuple[str, ...]] = ("masses", "floor")
    told_by: ClassVar[str] = "watch a marker on the robot's foot while the arm reaches out"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return a foundation that is alike in all directions, and one that is not."""
        return cls(robot, 1), cls(robot, 2)

    @property
    def detail(self) -> str:
        """Say which."""
        return "alike in all directions" if self.directions == 1 else "by direction"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliance, or those about x and y and what couples them."""
        largest = float(rated_torques(self.robot).max())
        sd, bound = TILT_SD / largest, TILT_BOUND / largest
        lowest = {"c": 0.0} if self.directions == 1 else {"cx": 0.0, "cy": 0.0, "cxy": -bound}
        words = "tilt of the base per overturning moment"
        return tuple(
            Parameter(self.id, "base", symbol, "rad/Nm", sd, low, bound, meaning=words)
            for symbol, low in lowest.items()
        )

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Tilt the base."""
        link = ca.SX(still.link)
        tilt = p if self.directions == 1 else ca.vertcat(ca.horzcat(p[0], p[2]), ca.horzcat(p[2], p[1]))
        link[3:5, 0] = tilt @ state.link[3:5, 0]
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the overturning moment."""
        return Variable("overturning moment", "Nm", lambda state, row: ca.norm_2(state.link[3:5, 0]))
