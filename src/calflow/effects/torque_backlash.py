"""Torque backlash: gear teeth in contact on the flank that the load presses them against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import NONLINEAR, JointError, Term, Words, torque_variable
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State

CROSSING = 0.01  # share of the rated torque within which the gear crosses its play
CROSSINGS = (0.002, 0.02)  # searched
WIDEST = 0.05  # a wider crossing is a nonlinear stiffness


@dataclass(frozen=True)
class TorqueBacklash(JointError):
    """dq = b/2 · sign(torque), smoothed to tanh within about crossing times the rated torque."""

    crossing: float = CROSSING

    id = "torque-backlash"
    title = "backlash by sign of torque"
    forms = dict.fromkeys(CROSSINGS, "")
    words = Words("backlash under load", "the gears change their flank where the load changes its sign", "play")
    family = NONLINEAR
    needs: ClassVar[tuple[str, ...]] = ("torques",)
    told_by = "measure some poses again with a load that turns the joint's torque around"

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return narrower and wider crossings."""
        near = (float(self.crossing * factor) for factor in np.geomspace(1 / 2, 2, 9))
        return tuple(replace(self, crossing=crossing) for crossing in near if crossing <= WIDEST)

    @property
    def detail(self) -> str:
        """The width of the crossing."""
        return f"crossed within {100 * self.crossing:.2g} % of the rated torque"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return half the play, signed by the torque."""
        side = ca.tanh(state.torque[joint] / (self.crossing * self.rated[joint]))
        return [Term("b", self.unit(joint), 3e-4, 10e-3, side / 2)]

    variable = torque_variable
