"""Torque backlash: gears that rest on the flank which the load presses them on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import NONLINEAR, JointError, Term, Words, torque_variable
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State

CROSSING = 0.01  # share of the rated torque within which a gear crosses its play
CROSSINGS = (0.002, 0.02)  # to look for
WIDEST = 0.05  # beyond it is a stiffness


@dataclass(frozen=True)
class TorqueBacklash(JointError):
    """dq = b/2 · sign(torque), smoothed where the torque changes sign: within about crossing times the rated torque."""

    crossing: float = CROSSING

    id = "torque-backlash"
    title = "backlash by sign of torque"
    forms = dict.fromkeys(CROSSINGS, "")
    words = Words("backlash under load", "the gears change their flank where the load changes its sign", "play")
    family = NONLINEAR
    needs = ("torques",)
    told_by = "measure some poses again with a load that turns the joint's torque around"

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return sharper and more gradual changes."""
        near = (float(self.crossing * factor) for factor in np.geomspace(1 / 2, 2, 9))
        return tuple(replace(self, crossing=crossing) for crossing in near if crossing <= WIDEST)

    @property
    def detail(self) -> str:
        """Say how sharp the change of sides is."""
        return f"crossed within {100 * self.crossing:.2g} % of the rated torque"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the half of the play, on the side the load presses."""
        side = ca.tanh(state.torque[joint] / (self.crossing * self.rated[joint]))
        return [Term("b", self.unit(joint), 3e-4, 10e-3, side / 2)]

    variable = torque_variable
