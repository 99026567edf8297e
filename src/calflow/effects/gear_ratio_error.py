"""Gear ratio error: a joint whose motion is a constant multiple of its reading, or one that grows as its rack does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca

from calflow.effects.base import JOINT_ALONE, NEEDS, TRANSMISSION, JointError, Term, Words
from calflow.effects.thermal_lag import ThermalLag
from calflow.effects.warming import WARMER
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

EXPANSION_SD = 2e-4  # m/m in 10 K: twice steel's


@dataclass(frozen=True)
class GearRatioError(JointError, ThermalLag):
    """dq = kappa q, or of a slide, whose rack or scale grows, with warm, dq = kappa q · (T - 20 degC) / 10 K in addition."""

    warm: bool = False

    id = "gear-ratio-error"
    title = "gear ratio error"
    words = Words("gear ratio error", "the joint moves too far or too little, by its gear or a hose's pull", "excess")
    family = TRANSMISSION
    readable = {"1": (1e6, "µrad/rad")}
    side_by_side = True
    told_by = JOINT_ALONE

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the constant ratio, and that of a slide that grows with the temperature, where it changes."""
        return (cls(robot), *(cls(robot, warm=True).lagging(data) if NEEDS["slide"].met(robot, ()) else ()))

    @property
    def detail(self) -> str:
        """What it grows with."""
        return f"with the temperature, 10 K above 20 degC{self.late}" if self.warm else ""

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the joint's angle, or a prismatic joint's position, times the warmth."""
        if not self.warm:
            unit = "1" if self.unit(joint) == "rad" else "m/m"
            return [Term("kappa", unit, 1e-3, 0.1, state.q[joint])]
        if self.robot.joints[joint].kind != "prismatic":
            return []
        grown = zip(self.symbols, self.above_reference(row), strict=True)
        return [Term(f"kappa{end}", "m/m", EXPANSION_SD, 0.01, by / WARMER * state.q[joint]) for end, by in grown]

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the growth alone, without that at first."""
        return super().size(p[:1], own[:1])
