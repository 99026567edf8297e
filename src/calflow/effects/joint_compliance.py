"""Joint compliance: drives and gears that wind up like linear torsional springs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import WINDUP_BOUND, WINDUP_SD, JointError, Term, Words, torque_variable
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class JointCompliance(JointError):
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

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the joint's torque."""
        unit, rated = f"{self.unit(joint)}/{self.robot.joints[joint].load_unit}", self.rated[joint]
        return [Term("s", unit, WINDUP_SD / rated, WINDUP_BOUND / rated, state.torque[joint], one_sided=True)]

    variable = torque_variable
