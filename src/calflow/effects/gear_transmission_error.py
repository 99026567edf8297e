"""Gear transmission error: a periodic error that repeats with every revolution of a joint's motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words, phases
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class GearTransmissionError(JointError):
    """dq = A cos(m N q) + B sin(m N q), N the gear ratio (prismatic: rad/m), m = 1 or 2 per motor revolution."""

    multiple: int = 1

    id = "gear-transmission-error"
    title = "gear transmission error"
    forms = {1: "1 a motor turn", 2: "2 a motor turn"}
    words = Words(
        "gear transmission error", "the joint is off by an amount that repeats with the turns of the motor", "amplitude"
    )
    needs = ("gear_ratio",)
    family = TRANSMISSION
    side_by_side = True
    told_by = JOINT_ALONE

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cosine and sine terms."""
        ratio = self.robot.joints[joint].gear_ratio
        if ratio is None:
            return []
        return phases(self.multiple * ratio * state.q[joint], self.unit(joint), 1.5e-4, 5e-3)
