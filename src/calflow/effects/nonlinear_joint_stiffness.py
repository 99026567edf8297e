"""Nonlinear joint stiffness: drives whose wind-up is not proportional to their torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import NONLINEAR, JointError, Term, Words, around, torque_variable
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot

BREAKS = (0.05, 0.2, 0.35, 0.5, 0.65)  # knees searched, as shares of the rated torque
REACH = 0.15  # distance from a knee to its neighbours
EARLIEST = 0.02  # share: an earlier knee is backlash


@dataclass(frozen=True)
class NonlinearJointStiffness(JointError):
    """dq = c3 (torque / rated)^3, or -c · (|torque| / rated - knee) · sign(torque) beyond the knee, or c1 |torque| / rated.

    knee = 0 stands for the cubic law, uneven for the last one: the flanks of teeth, or the strands of a belt, that are not equally
    stiff. Each acts in addition to the linear compliance.
    """

    knee: float = 0.0
    uneven: bool = False

    id = "nonlinear-joint-stiffness"
    title = "nonlinear joint stiffness"
    forms = dict.fromkeys((0.0, *BREAKS), "")
    words = Words(
        "nonlinear stiffness", "the drive does not twist in proportion to its torque", "departure at the rated torque"
    )
    family = NONLINEAR
    needs = ("torques",)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the laws that are alike to either side, and the one that is not."""
        return (*super().variants(robot, data), cls(robot, uneven=True))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return knees about this one."""
        if not self.knee:
            return ()
        return tuple(replace(self, knee=knee) for knee in around(self.knee, REACH) if knee >= EARLIEST)

    @property
    def detail(self) -> str:
        """The stiffness law."""
        if self.uneven:
            return "softer to one side than to the other"
        return f"stiffer beyond {self.knee:.0%} of the rated torque" if self.knee else "cubic"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cube of the torque, its excess beyond the knee, or its amount."""
        share = self.load(joint, state)
        if self.uneven:
            return [Term("c1", self.unit(joint), 1e-3, 20e-3, ca.fabs(share))]
        if not self.knee:
            return [Term("c3", self.unit(joint), 1e-3, 20e-3, share**3)]
        beyond = ca.fmax(ca.fabs(share) - self.knee, 0)
        return [Term("c", self.unit(joint), 2e-3, 40e-3, -ca.sign(share) * beyond, one_sided=True)]

    variable = torque_variable
