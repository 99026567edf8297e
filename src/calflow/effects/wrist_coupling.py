"""Wrist coupling: wrist gears that turn with the joints before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calflow.effects.base import Variable
from calflow.effects.joint_error import JointError, Term
from calflow.robot.conditions import Row
from calflow.robot.statics import State


@dataclass(frozen=True)
class WristCoupling(JointError):
    """dq5 = k54 q4, dq6 = k64 q4 + k65 q5, for the last three joints of a robot with six or more."""

    id: ClassVar[str] = "wrist-coupling"
    title: ClassVar[str] = "wrist coupling"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the angles of the wrist's joints before this one."""
        n = self.robot.n_joints
        first = n - 3
        if n < 6 or joint <= first:
            return []
        return [Term(f"k{joint + 1}{k + 1}", "1", 1e-3, 0.1, state.q[k]) for k in range(first, joint)]

    def variable(self, joint: int) -> Variable:
        """Return the angle of the joint before."""
        return Variable(
            f"angle of joint {joint - 1}", "deg", lambda state, row: state.q[joint - 2], float(np.rad2deg(1.0))
        )
