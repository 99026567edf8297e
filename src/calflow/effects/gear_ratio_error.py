"""Gear ratio error: a joint whose motion is a constant multiple of its reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class GearRatioError(JointError):
    """dq = kappa q."""

    id = "gear-ratio-error"
    title = "gear ratio error"
    words = Words("gear ratio error", "the joint turns more, or less, than its reading says", "excess")
    family = TRANSMISSION
    readable = {"1": (1e6, "µrad/rad")}
    told_by = JOINT_ALONE

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the joint's angle, or a prismatic joint's position."""
        unit = "1" if self.unit(joint) == "rad" else "m/m"
        return [Term("kappa", unit, 1e-3, 0.1, state.q[joint])]
