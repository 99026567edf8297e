"""Gear transmission error: what repeats with every turn of a joint's motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from calflow.effects.base import Words
from calflow.effects.joint_error import JOINT_ALONE, TRANSMISSION, JointError, Term, phases
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class GearTransmissionError(JointError):
    """dq = A cos(m N q) + B sin(m N q) at the gear ratio N (a slide's in rad/m), m = 1 or 2."""

    multiple: int = 1

    id: ClassVar[str] = "gear-transmission-error"
    title: ClassVar[str] = "gear transmission error"
    words: ClassVar[Words] = Words(
        "gear transmission error", "the angle is off by an amount that repeats with the turns of the motor", "amplitude"
    )
    needs: ClassVar[tuple[str, ...]] = ("gear_ratio",)
    family: ClassVar[str] = TRANSMISSION
    told_by: ClassVar[str] = JOINT_ALONE

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return once and twice a turn."""
        return cls(robot, 1), cls(robot, 2)

    def same_as(self, other: Self) -> bool:
        """Return whether it repeats as often."""
        return other.multiple == self.multiple

    @property
    def detail(self) -> str:
        """Say how often it repeats."""
        return f"{self.multiple} a motor turn"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the two phases."""
        ratio = self.robot.joints[joint].gear_ratio
        if ratio is None:
            return []
        return phases(self.multiple * ratio * state.q[joint], self.unit(joint), 1.5e-4, 5e-3)
