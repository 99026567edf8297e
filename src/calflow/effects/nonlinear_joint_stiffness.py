"""Nonlinear joint stiffness: drives that do not wind up in proportion to their torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import NONLINEAR, JointError, Term, Words, around, torque_variable
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State

BREAKS = (0.05, 0.2, 0.35, 0.5, 0.65)  # shares of the rated torque at which a stiffer branch may begin
REACH = 0.15  # about a break, to its neighbours
EARLIEST = 0.02  # share: what gives way before it is play


@dataclass(frozen=True)
class NonlinearJointStiffness(JointError):
    """dq = c3 (torque / rated)^3, or dq = -c · (|torque| / rated - break) · sign(torque) beyond the break torque.

    knee is that torque over the rated one; 0 stands for the cubic law. Both come besides the linear compliance.
    """

    knee: float = 0.0

    id = "nonlinear-joint-stiffness"
    title = "nonlinear joint stiffness"
    forms = dict.fromkeys((0.0, *BREAKS), "")
    words = Words(
        "nonlinear stiffness", "the drive does not twist in proportion to its torque", "departure at the rated torque"
    )
    family = NONLINEAR
    needs = ("torques",)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return break torques about this one."""
        if not self.knee:
            return ()
        return tuple(replace(self, knee=knee) for knee in around(self.knee, REACH) if knee >= EARLIEST)

    @property
    def detail(self) -> str:
        """Say the law."""
        return f"stiffer beyond {self.knee:.0%} of the rated torque" if self.knee else "cubic"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cube of the torque, or what of it is beyond the break."""
        share = self.load(joint, state)
        if not self.knee:
            return [Term("c3", self.unit(joint), 1e-3, 20e-3, share**3)]
        beyond = ca.fmax(ca.fabs(share) - self.knee, 0)
        return [Term("c", self.unit(joint), 2e-3, 40e-3, -ca.sign(share) * beyond, one_sided=True)]

    variable = torque_variable
