"""Joint hysteresis: friction that winds up a drive after each reversal, until it slips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.effects.base import LOST_MOTION, REVERSALS, JointError, Term, Variable, Words
from calflow.robot.mechanism import Row, State

LENGTHS = np.deg2rad([1.0, 2.0, 4.0, 8.0, 16.0])  # rad (prismatic: m): transition lengths searched


@dataclass(frozen=True)
class JointHysteresis(JointError):
    """dq = h · direction · (1 - 2 exp(-travel / length)), travel counted from the last reversal (Dahl 1968)."""

    length: float = float(LENGTHS[2])

    id = "joint-hysteresis"
    title = "hysteresis by friction"
    forms = dict.fromkeys(LENGTHS.tolist(), "")
    words = Words(
        "hysteresis",
        "friction leaves the drive wound up after each reversal, until the joint has moved on far enough",
        "wind-up to one side",
    )
    family = LOST_MOTION
    needs = ("approach", "travel")
    alike = ("joint-backlash",)
    told_by = REVERSALS

    @property
    def detail(self) -> str:
        """The travel over which it develops, of all kinds of joints."""
        return self.detail_at(0)

    def detail_at(self, joint: int) -> str:
        """Return the travel over which it develops, at a joint or (0) at all kinds of them."""
        joints = self.robot.joints[joint - 1 : joint] if joint else self.robot.joints
        shown = dict.fromkeys(moved.shown for moved in joints)
        return f"developed after {' or '.join(f'{factor * self.length:.3g} {unit}' for unit, factor in shown)}"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the wind-up after the travel since the last reversal."""
        developed = 1 - 2 * ca.exp(-row.travel[joint] / self.length)
        return [Term("h", self.unit(joint), 2e-4, 10e-3, row.approach[joint] * developed)]

    def variable(self, joint: int) -> Variable:
        """Return the travel since the reversal, signed by its direction."""
        unit, factor = self.robot.joints[joint - 1].shown
        return Variable(f"travel of joint {joint} since its reversal", unit,
                        lambda state, row: row.approach[joint - 1] * row.travel[joint - 1], factor)  # fmt: skip
