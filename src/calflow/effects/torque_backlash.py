"""Torque backlash: gears that rest on the flank which the load presses them on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np

from calflow.conditions import Row
from calflow.effects.base import Variable
from calflow.effects.joint_error import JointError, Term
from calflow.robot.statics import State, rated_torques

PLAY = 0.01  # share of the rated torque within which a gear crosses its play


@dataclass(frozen=True)
class TorqueBacklash(JointError):
    """dq = b/2 · sign(torque), smoothed where the torque changes sign."""

    id: ClassVar[str] = "torque-backlash"
    title: ClassVar[str] = "backlash by sign of torque"
    needs: ClassVar[tuple[str, ...]] = ("torques",)
    told_by: ClassVar[str] = "measure some poses again with a load that turns the joint's torque around"

    @cached_property
    def rated(self) -> np.ndarray:
        """Rated torques [Nm], shape (n_joints,)."""
        return rated_torques(self.robot)

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the half of the play, on the side the load presses."""
        return [Term("b", "rad", 3e-4, 10e-3, ca.tanh(state.torque[joint] / (PLAY * self.rated[joint])) / 2)]

    def variable(self, joint: int) -> Variable:
        """Return the joint's torque."""
        return Variable(f"torque of joint {joint}", "Nm", lambda state, row: state.torque[joint - 1])
