"""Warming: base class of effects proportional to a measured temperature or to a warm-up curve in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, around
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.robot import Robot

REFERENCE = 293.15  # K: reference temperature of drawings (ISO 1)
WARM_UPS = (900.0, 1800.0, 3600.0, 7200.0)  # s: time constants searched


@dataclass(frozen=True)
class Warming(Effect):
    """An effect proportional to T - 20 degC, or to 1 - exp(-t / constant) as the robot warms up.

    constant is the time constant of the warm-up [s]; 0 stands for a measured temperature.
    """

    constant: float = 0.0

    shown_by = "warmth"
    taken_for = ("frame-drift",)
    told_by = "measure some poses again when the robot is cold"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature, and with a grid of time constants where times are known."""
        forms = (cls(robot),) if data.temperature_changes else ()
        return (*forms, *(cls(robot, constant) for constant in WARM_UPS)) if "time" in data.given else forms

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return time constants about this one."""
        if not self.constant:
            return ()
        return tuple(replace(self, constant=float(np.exp(log))) for log in around(np.log(self.constant), np.log(2)))

    @property
    def detail(self) -> str:
        """What it grows with."""
        return f"warming up in {self.constant / 3600:.2g} h" if self.constant else "with the temperature"

    def warmth(self, row: Row) -> ca.SX:
        """Return the temperature above 20 degC [K], or the warm-up curve (0 to 1); structurally zero where a row has neither."""
        if self.constant:
            return 1 - ca.exp(-row.time / self.constant) if row.time.nnz() else ca.SX(1, 1)
        return row.temperature - REFERENCE if row.temperature.nnz() else ca.SX(1, 1)

    def variable(self, joint: int) -> Variable:
        """Return the temperature, or the time."""
        if self.constant:
            return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
        return Variable("temperature above 20 degC", "K", lambda state, row: row.temperature - REFERENCE)
