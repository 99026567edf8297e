"""Warming: base class of effects proportional to a measured temperature or to a warm-up curve in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, around
from calflow.measurements.measurements import Measurements, pauses
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

NEVER = ((np.inf, np.inf),)  # in place of no pause, which has fewer parameters
REFERENCE = 293.15  # K: reference temperature of drawings (ISO 1)
WARMER = 10.0  # K above 20 degC at which an error that is proportional to these is stated
WARM_UPS = (900.0, 1800.0, 3600.0, 7200.0)  # s: time constants searched


@dataclass(frozen=True)
class Warming(Effect):
    """An effect proportional to T - 20 degC, or to 1 - exp(-t / constant) as the robot warms up.

    constant is the time constant of the warm-up [s]; 0 stands for a measured temperature. In pauses, each from a time to
    another [s], the robot cools down with the same constant: a body of one heat capacity, whose motors stand meanwhile.
    Each part has one parameter, and with pauses another for the heat with which it came to the first row.
    """

    constant: float = 0.0
    pauses: tuple[tuple[float, float], ...] = ()

    unnamed: ClassVar[tuple[str, ...]] = ("pauses",)
    taken_for: ClassVar[tuple[str, ...]] = ("frame-drift",)
    course: ClassVar[str] = "warming up"
    told_by = "measure some poses again when the robot is cold"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature and, where times are known, of an arm that warms up once or after each pause."""
        forms = (cls(robot),) if data.temperature_changes else ()
        if "time" not in data.given:
            return forms
        rests = dict.fromkeys([(), pauses(data)])
        return (*forms, *(cls(robot, constant, rest) for rest in rests for constant in WARM_UPS))

    @classmethod
    def asks(cls, robot: Robot, data: Measurements) -> tuple[str, ...]:
        """Return the unmet needs, among them times or temperatures that change."""
        shown = data.temperature_changes or "time" in data.given
        return (*super().asks(robot, data), *(() if shown else ("warmth",)))

    def later(self, series: Measurements | None) -> Self:
        """Return the same with the pauses of a series that has a clock of its own: it begins as warm as the fitted rows."""
        return self if series is None or not self.pauses else replace(self, pauses=pauses(series) or NEVER)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return time constants about this one."""
        if not self.constant:
            return ()
        return tuple(replace(self, constant=float(np.exp(log))) for log in around(np.log(self.constant), np.log(2)))

    @property
    def detail(self) -> str:
        """What it grows with."""
        if not self.constant:
            return "with the temperature"
        return f"{self.course} in {self.constant / 3600:.2g} h{', anew after each pause' if self.pauses else ''}"

    @property
    def variant(self) -> str:
        """Short name of the form, and whether there are pauses."""
        return super().variant + " anew" * bool(self.pauses)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Endings of the symbols of a part's parameters."""
        return ("", "0") if self.pauses else ("",)

    def warmth(self, p: ca.SX, row: Row) -> ca.SX:
        """Return each part's parameters (parts after another) times the temperature above 20 degC [K] or the warm-up (0 to 1).

        It is structurally zero where a row has neither.
        """
        if not self.constant:
            return p * (row.temperature - REFERENCE) if row.temperature.nnz() else ca.SX(*p.shape)
        if not row.time.nnz():
            return ca.SX(p.numel() // len(self.symbols), 1)
        risen = self._risen(row.time)
        for end, start in self.pauses:
            risen += self._risen(row.time - start) - self._risen(row.time - end)
        of_parameters = [risen, 1 - self._risen(row.time)][: len(self.symbols)]
        return ca.reshape(p, len(of_parameters), -1).T @ ca.vertcat(*of_parameters)

    def _risen(self, passed: ca.SX) -> ca.SX:
        """Return the response to a step of heating, a time after it [s]."""
        return 1 - ca.exp(-ca.fmax(0, passed) / self.constant)

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the growth alone, without the heat at first."""
        return super().size(p[:1], own[:1])

    def variable(self, joint: int) -> Variable:
        """Return the temperature, or the time."""
        if self.constant:
            return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
        return Variable("temperature above 20 degC", "K", lambda state, row: row.temperature - REFERENCE)


def warmer(row: Row) -> ca.SX:
    """Return a row's temperature above 20 degC over WARMER, zero where it is unknown."""
    return (row.temperature - REFERENCE) / WARMER if row.temperature.nnz() else ca.SX(0)
