"""Periodic joint error: a transmission or encoder error of unknown order per revolution, or wavelength along a slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words, around, phases
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot

LOWEST, HIGHEST = 2.5, 30.0  # orders searched; lower ones are eccentricity
PHASE = 0.8  # rad: largest phase difference of neighbouring orders at the ends of a joint's travel


@dataclass(frozen=True)
class PeriodicJointError(JointError):
    """dq = A cos(order q) + B sin(order q); for a prismatic joint q is in m and the wavelength 2 pi / order."""

    order: float = 3.0

    id = "periodic-joint-error"
    title = "periodic error"
    words = Words("periodic error", "the joint is off by an amount that repeats as it moves", "amplitude")
    family = TRANSMISSION
    told_by = JOINT_ALONE

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return orders spaced so densely that any order between two hardly differs from them over the largest travel."""
        return tuple(cls(robot, float(order)) for order in np.arange(LOWEST, HIGHEST, _step(data)))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return orders about this one."""
        return tuple(replace(self, order=order) for order in around(self.order, _step(data)) if order >= LOWEST)

    def same_as(self, other: Self) -> bool:
        """Whether the orders are too close to be two separate waves over one revolution."""
        return abs(other.order - self.order) < 1.0

    @property
    def detail(self) -> str:
        """The order."""
        return f"order {self.order:.3g}"

    def detail_at(self, joint: int) -> str:
        """Return the order, and of a prismatic joint the wavelength."""
        slides = joint and self.robot.joints[joint - 1].kind == "prismatic"
        return f"{self.detail}, on a slide every {2e3 * np.pi / self.order:.3g} mm" if slides else self.detail

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cosine and sine terms."""
        return phases(self.order * state.q[joint], self.unit(joint), 3e-4, 10e-3)


def _step(data: Measurements) -> float:
    return 2 * PHASE / max(1.0, float(np.ptp(data.joints, axis=0).max()))
