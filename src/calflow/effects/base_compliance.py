"""Base compliance: a foundation that tilts elastically under the robot's overturning moment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Variable, Words
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter

TILT_SD, TILT_BOUND = 0.5e-3, 10e-3  # rad at the largest rated torque of all joints


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """Tilt of the base = C (Mx, My), M the overturning moment; C a scalar (isotropic) or a symmetric matrix."""

    directions: int = 1

    id = "base-compliance"
    title = "base compliance (tilt of the foundation)"
    forms = {1: "alike in all directions", 2: "by direction"}
    words = Words(
        "compliance of the base", "the base or its foundation tilts under the overturning moment", "compliance"
    )
    whole = "base"
    needs = ("masses", "floor")
    told_by = "watch a marker on the robot's foot while the arm reaches out"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliance, or those about x and y with their coupling term."""
        largest = float(rated_torques(self.robot).max())
        sd, bound = TILT_SD / largest, TILT_BOUND / largest
        lowest = {"c": 0.0} if self.directions == 1 else {"cx": 0.0, "cy": 0.0, "cxy": -bound}
        words = "tilt of the base per overturning moment"
        return tuple(
            Parameter(self.id, "base", symbol, "rad/Nm", sd, low, bound, meaning=words)
            for symbol, low in lowest.items()
        )

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the base tilted."""
        link = ca.SX(still.link)
        tilt = p if self.directions == 1 else ca.vertcat(ca.horzcat(p[0], p[2]), ca.horzcat(p[2], p[1]))
        link[3:5, 0] = tilt @ state.link[3:5, 0]
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the overturning moment."""
        return Variable("overturning moment", "Nm", lambda state, row: ca.norm_2(state.link[3:5, 0]))
