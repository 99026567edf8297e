"""Wrist coupling: wrist joints driven a little by the motion of others, and a quill that slides as its shaft turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.effects.base import JointError, Term, Variable, Words, joint_variable
from calflow.robot.mechanism import Row, State, nominal_posture

SIZES = {"rad": (1e-3, 0.1), "m": (1e-4, 5e-3)}  # standard deviation and bound, per rad or m of the other joint
PARALLEL = 1e-6


@dataclass(frozen=True)
class WristCoupling(JointError):
    """dq5 = k54 q4, dq6 = k64 q4 + k65 q5, for the last three joints of a chain of six or more; of a shorter one whose last two
    joints slide and turn along one direction, dq_slide = k q_turn: two nuts move one shaft, with a screw and with a spline.
    """

    id = "wrist-coupling"
    title = "wrist coupling"
    words = Words("wrist coupling", "the joint moves a little where others of the wrist turn", "coupling")
    readable = {"1": (1e6, "µrad/rad"), "m/rad": (1e6, "µm/rad")}

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the angles of the wrist's joints that move this one."""
        units = {k: f"{self.unit(joint)}/{self.unit(k)}".replace("rad/rad", "1") for k in self._movers(joint)}
        sizes = SIZES[self.unit(joint)]
        return [Term(f"k{joint + 1}{k + 1}", unit, *sizes, state.q[k]) for k, unit in units.items()]

    def variable(self, joint: int) -> Variable:
        """Return the angle of the nearest joint that moves this one."""
        return joint_variable(self, self._movers(joint - 1)[-1] + 1)

    def _movers(self, joint: int) -> list[int]:
        """Return the indices of the joints whose motion moves this one (index from 0)."""
        for chain in map(self.robot.chain, self.robot.tips):
            if joint in chain[-2:]:
                wrist = list(chain[-3:])
                return wrist[: wrist.index(joint)] if len(chain) >= 6 else self._turning(joint, list(chain[-2:]))
        return []

    def _turning(self, slide: int, shaft: list[int]) -> list[int]:
        """Return the joint of a shaft that turns along the slide, where it slides."""
        kinds = [self.robot.joints[k].kind for k in shaft]
        if sorted(kinds) != ["prismatic", "revolute"] or self.robot.joints[slide].kind == "revolute":
            return []
        at = nominal_posture(self.robot)
        axes = [np.array(ca.evalf(at.joints[k][:3, 2])).ravel() for k in shaft]
        along = abs(axes[0] @ axes[1]) > 1 - PARALLEL
        return [k for k in shaft if k != slide] if along else []
