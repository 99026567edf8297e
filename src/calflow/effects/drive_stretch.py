"""Drive stretch: a linear axis's belt, rope or long screw that its load stretches, the more the longer it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import TRANSMISSION, JointError, Term, Words
from calflow.robot.mechanism import Row, State

STRETCH_SD, STRETCH_BOUND = 3e-4, 20e-3  # m/m at the rated force


@dataclass(frozen=True)
class DriveStretch(JointError):
    """dq = kappa q · force / rated: the part that carries the load grows with the travel q.

    The stretch of what is free at q = 0 is that of `joint-compliance`.
    """

    id = "drive-stretch"
    title = "stretch of a linear axis's drive"
    words = Words(
        "stretch of the drive",
        "its load stretches the belt, rope or screw of the axis, the more the longer the part that carries it",
        "stretch at the rated force",
    )
    family = TRANSMISSION
    needs = ("slide", "torques")
    told_by = "move the axis alone over all its travel, with and without a load, and measure closely"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the position of a linear axis times its force."""
        if self.robot.joints[joint].kind != "prismatic":
            return []
        return [Term("kappa", "m/m", STRETCH_SD, STRETCH_BOUND, state.q[joint] * self.load(joint, state))]
