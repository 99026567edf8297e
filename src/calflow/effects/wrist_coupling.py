"""Wrist coupling: wrist joints driven a little by the motion of the wrist joints before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import JointError, Term, Variable, Words, joint_variable
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class WristCoupling(JointError):
    """dq5 = k54 q4, dq6 = k64 q4 + k65 q5, for the last three joints of a chain of six or more."""

    id = "wrist-coupling"
    title = "wrist coupling"
    words = Words("wrist coupling", "the joint turns a little where the wrist's joints before it turn", "coupling")
    readable = {"1": (1e6, "µrad/rad")}

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the angles of the wrist's joints before this one."""
        chains = [self.robot.chain(tip) for tip in self.robot.tips]
        wrist = next((chain[-3:] for chain in chains if len(chain) >= 6 and joint in chain[-2:]), [joint])
        before = wrist[: wrist.index(joint)]
        units = {k: f"{self.unit(joint)}/{self.unit(k)}".replace("rad/rad", "1") for k in before}
        return [Term(f"k{joint + 1}{k + 1}", unit, 1e-3, 0.1, state.q[k]) for k, unit in units.items()]

    def variable(self, joint: int) -> Variable:
        """Return the angle of the joint before."""
        return joint_variable(self, joint - 1)
