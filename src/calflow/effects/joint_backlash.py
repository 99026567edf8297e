"""Joint backlash: gear teeth in contact on the flank that the last motion left loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import LOST_MOTION, REVERSALS, JointError, Term, Variable, Words
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class JointBacklash(JointError):
    """dq = b/2 · direction of approach."""

    id = "joint-backlash"
    title = "backlash by direction of approach"
    words = Words(
        "backlash", "the gears rest on one flank or the other, depending on the side the joint came from", "play"
    )
    family = LOST_MOTION
    needs = ("approach",)
    alike = ("joint-hysteresis",)  # where it is fully developed at every pose
    taken_for = ("torque-backlash",)  # gravity often decides the flank
    told_by = REVERSALS

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return half the play, signed by the direction of approach."""
        return [Term("b", self.unit(joint), 3e-4, 50e-3, row.approach[joint] / 2)]

    def variable(self, joint: int) -> Variable:
        """Return the direction of approach."""
        return Variable(f"approach of joint {joint}", "", lambda state, row: row.approach[joint - 1])
