"""Joint error map: a transmission or encoder error of no single order, as a smooth curve over a joint's travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words
from calflow.effects.smooth_curve import RMS, Travel, different_positions, travel_ends, waves
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

AMPLITUDE = 2e-4  # rad rms a priori
LENGTHS = (0.06, 0.15, 0.5)  # rad: correlation lengths searched
FINEST = 0.05  # rad: finest resolution
DENSE = 4  # distinct readings required per correlation length
DENSEST = 2  # distinct readings per step of the finest resolution, which suffice at any length
FEWEST = 40  # distinct readings required in all: fewer do not tell a curve from the geometry beside it
SHORTEST = 0.25  # rad: travel with a curve
GRID = 1000  # angles over the travel, for means


@dataclass(frozen=True)
class JointErrorMap(JointError):
    """dq = f(q), f a smooth curve over the joint's travel (see `waves`).

    low and high bound the travel of each joint that the data cover [rad]; length is the correlation length [rad].
    """

    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    length: float = LENGTHS[0]

    id = "joint-error-map"
    title = "joint error map"
    words = Words(
        "angle error curve", "the angle is off by a smooth curve over the joint's travel, of no single order", "rms"
    )
    family = TRANSMISSION
    is_curve = True
    told_by = JOINT_ALONE
    unnamed = ("low", "high")

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return maps at each correlation length, of the joints whose travel is covered densely enough for it."""
        dense = {length: _dense(robot, data, length) for length in LENGTHS}
        return tuple(cls(robot, *travel_ends(data, joints), length) for length, joints in dense.items() if joints.any())

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return the density of readings required where no joint has it."""
        longest = max(LENGTHS)
        few = f"at least {FEWEST} different readings of a joint, and {DENSE} per {longest} rad"
        return "" if _dense(robot, data, longest).any() else few

    @property
    def detail(self) -> str:
        """The correlation length."""
        return f"alike over {self.length:g} rad"

    def travel(self, joint: int) -> Travel | None:
        """Return the travel that the data cover."""
        low, high, angle = self.low[joint - 1], self.high[joint - 1], ca.SX.sym("angle")
        curve = waves(angle, low, high, self.length, FINEST)
        values = ca.Function("waves", [angle], [ca.vertcat(*(wave.value for wave in curve))])
        basis = np.array(values(np.linspace(low, high, GRID)[None]))
        return Travel(low, high, self.length, basis @ basis.T / GRID)

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the curve's root mean square (a wave of amplitude 1 has 1/sqrt(2))."""
        return super().size(p, own) * RMS

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the sine basis functions, longest wavelength first."""
        if not self.low or self.high[joint] <= self.low[joint]:
            return []
        curve = waves(state.q[joint], self.low[joint], self.high[joint], self.length, FINEST)
        return [Term(f"wave{wave.number}", "rad", AMPLITUDE * wave.sd, 0.05, wave.value) for wave in curve]


def _dense(robot: Robot, data: Measurements, length: float) -> np.ndarray:
    """Return which joints are revolute and covered densely enough for a correlation length [rad]."""
    travel = np.ptp(data.joint_angles, axis=0)
    turns = np.array([joint.kind == "revolute" for joint in robot.joints])
    required = np.maximum(FEWEST, travel * min(DENSE / length, DENSEST / FINEST))
    return turns & (travel > SHORTEST) & (different_positions(data) >= required)
