"""Joint compliance: drives and gears that wind up like linear torsional springs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import WINDUP_BOUND, WINDUP_SD, Effect, Words, torque_variable
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class JointCompliance(Effect):
    """dq = s · torque at every driven joint (equation 7 of the HH800 paper), s >= 0 in rad/Nm (prismatic: m/N).

    Compliance scales with the size of the joint, so the prior is on the wind-up at rated torque.
    """

    id = "joint-compliance"
    title = "joint compliance (linear torsional springs)"
    words = Words("compliance", "the drive twists in proportion to its torque", "compliance")
    tag = ""
    inevitable = True
    needs = ("torques",)

    @classmethod
    def springs(cls, robot: Robot) -> bool:
        """Whether the masses are known, so that this effect is the joint compliance."""
        return robot.has_masses

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one compliance per joint."""
        return tuple(
            Parameter(self.id, f"joint{i}", "s", f"{joint.unit}/{joint.load_unit}", WINDUP_SD / rated, 0.0,
                      WINDUP_BOUND / rated, meaning=f"compliance of joint {i}", joint=i)
            for i, (joint, rated) in enumerate(zip(self.robot.joints, rated_torques(self.robot), strict=True), start=1)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the wind-up of each driven joint."""
        return replace(still, joint=p * state.torque)

    variable = torque_variable
