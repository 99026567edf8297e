"""Nonlinear joint stiffness: drives whose wind-up is not proportional to their torque."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import casadi as ca

from calflow.effects.base import NONLINEAR, JointError, Term, Words, around, torque_variable
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot

Law = Literal["cubic", "knee", "uneven"]
KNEES = (0.05, 0.2, 0.35, 0.5, 0.65)  # searched, as shares of the rated torque
REACH = 0.15  # distance from a knee to its neighbours
EARLIEST = 0.02  # share: an earlier knee is backlash


@dataclass(frozen=True)
class NonlinearJointStiffness(JointError):
    """dq = c3 (torque / rated)^3, or -c · (|torque| / rated - knee) · sign(torque) beyond the knee, or c1 |torque| / rated.

    The last law is that of flanks of teeth, or strands of a belt, that are not equally stiff. Each acts in addition to the linear
    compliance.
    """

    law: Law = "cubic"
    knee: float = 0.0  # share of the rated torque, of the second law

    id = "nonlinear-joint-stiffness"
    title = "nonlinear joint stiffness"
    words = Words(
        "nonlinear stiffness", "the drive does not twist in proportion to its torque", "departure at the rated torque"
    )
    family = NONLINEAR
    needs = ("torques",)

    @classmethod
    def of_figures(cls, robot: Robot, text: str) -> Self:
        """Return the effect rebuilt from its `figures_text`; earlier runs state a knee without a law."""
        figures = json.loads(text)
        earlier = {"law": "knee"} if figures.get("knee") else {}
        return super().of_figures(robot, json.dumps(earlier | figures))

    @property
    def variant(self) -> str:
        """The law, by its knee where it has one; empty for the cubic one."""
        return {"cubic": "", "knee": f"knee {self.knee:.8g}", "uneven": "uneven"}[self.law]

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each law, that of a knee with several."""
        return (cls(robot), *(cls(robot, "knee", knee) for knee in KNEES), cls(robot, "uneven"))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return knees about this one."""
        if self.law != "knee":
            return ()
        return tuple(replace(self, knee=knee) for knee in around(self.knee, REACH) if knee >= EARLIEST)

    @property
    def detail(self) -> str:
        """The stiffness law."""
        return {
            "cubic": "cubic",
            "knee": f"stiffer beyond {self.knee:.0%} of the rated torque",
            "uneven": "softer to one side than to the other",
        }[self.law]

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cube of the torque, its excess beyond the knee, or its amount."""
        share, unit = self.load(joint, state), self.unit(joint)
        if self.law == "cubic":
            return [Term("c3", unit, 1e-3, 20e-3, share**3)]
        if self.law == "uneven":
            return [Term("c1", unit, 1e-3, 20e-3, ca.fabs(share))]
        beyond = ca.fmax(ca.fabs(share) - self.knee, 0)
        return [Term("c", unit, 2e-3, 40e-3, -ca.sign(share) * beyond, one_sided=True)]

    variable = torque_variable
