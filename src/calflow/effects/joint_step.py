"""Joint step: a joint whose zero jumped once, by a collision, a slipped belt or a lost count of its encoder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.step_change import BOUND, StepChange
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

JUMP_SD = 3e-4  # rad, or m


@dataclass(frozen=True)
class JointStep(StepChange):
    """Joint's reading - jump, up to a row.

    A jump that is as large as a mistake of the set-up is `zero-changed`.
    """

    id = "joint-step"
    title = "jump of a joint's zero"
    words = Words(
        "jump of the zero",
        "the zero changed once: a collision, a slipped belt or a lost count; or the foot turned",
        "jump",
    )
    told_by = "measure some of the first poses again, and the robot's foot beside them"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the jump of each joint that has a reading of its own."""
        joints = ((i + 1, self.robot.joints[i].unit) for i in self.robot.driven)
        return tuple(
            Parameter(self.id, f"joint{joint}", "jump", unit, JUMP_SD, -BOUND * JUMP_SD, BOUND * JUMP_SD,
                      meaning=f"jump of the zero of joint {joint}", joint=joint)
            for joint, unit in joints
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the joints as they were before the moment, with those whose angle a reading counts in too."""
        by_reading = self.robot.reading_matrix[:, self.robot.driven]
        by_reading[self.robot.followers] = 0.0  # they go where their drives are
        moved = ca.sparsify(ca.DM(by_reading))
        before = self.before(row)
        return replace(still, joint=moved @ (-before * p)) if before.nnz() else still
