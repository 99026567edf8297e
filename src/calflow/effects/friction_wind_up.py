"""Friction wind-up: a drive left wound up against its last motion by friction that grows with the load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import LOST_MOTION, JointError, Term, Variable, Words, torque_variable
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class FrictionWindUp(JointError):
    """dq = h · direction of approach · |torque| / rated: the part of friction that grows with the load.

    The wind-up without load belongs to `joint-backlash` and has no parameter here, so that both can act at one joint.
    """

    id = "friction-wind-up"
    title = "wind-up by friction that grows with load"
    words = Words(
        "friction wind-up",
        "friction leaves the drive wound up against its last motion, the more the larger its load is",
        "wind-up to one side at the rated torque",
    )
    family = LOST_MOTION
    needs = ("approach", "torques")
    told_by = "approach some poses from both sides, with and without a load"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the wind-up, signed by the direction of approach."""
        return [Term("h", self.unit(joint), 2e-4, 10e-3, row.approach[joint] * ca.fabs(self.load(joint, state)))]

    def variable(self, joint: int) -> Variable:
        """Return the magnitude of the joint's torque, signed by the direction of approach."""
        torque = torque_variable(self, joint)
        by_approach = lambda state, row: row.approach[joint - 1] * ca.fabs(torque.value(state, row))  # noqa: E731
        return Variable(f"{torque.label} by approach", torque.unit, by_approach)
