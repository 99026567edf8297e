"""Warming: base class of effects proportional to a measured temperature or to a warm-up curve in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import Variable, around
from calflow.effects.thermal_lag import REFERENCE, ThermalLag
from calflow.measurements.measurements import Measurements, pauses
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

NEVER = ((np.inf, np.inf),)  # in place of no pause, which has fewer parameters
WARMER = 10.0  # K above 20 degC at which an error that is proportional to these is stated
WARM_UPS = (900.0, 1800.0, 3600.0, 7200.0)  # s: time constants searched
SHIFT = 8 * 3600.0  # s: how long a robot that works in shifts works on, on average
IN_SHIFTS = 0.5  # probability that it does, and does not work around the clock
ALIKE = 1e-6  # relative difference of rates below which they are the same


@dataclass(frozen=True)
class Warming(ThermalLag):
    """An effect proportional to T - 20 degC, T the air's or that of what follows it, or to 1 - exp(-t / constant) as it warms up.

    constant is the time constant of the warm-up [s]; 0 stands for a measured temperature. In pauses, each from a time to
    another [s], the robot cools down with the same constant: a body of one heat capacity, whose motors stand meanwhile.
    Until a time [s] it is known to work, or to rest; later it is as warm as is to be expected of a robot that may stand.
    Each part has one parameter, and with pauses another for the heat with which it came to the first row.
    """

    constant: float = 0.0
    pauses: tuple[tuple[float, float], ...] = ()
    until: float = np.inf

    unnamed: ClassVar[tuple[str, ...]] = (*ThermalLag.unnamed, "pauses", "until")
    taken_for: ClassVar[tuple[str, ...]] = ("frame-drift",)
    course: ClassVar[str] = "warming up"
    told_by = "measure some poses again when the robot is cold"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature and, where times are known, of an arm that warms up once or after each pause."""
        forms = cls(robot).lagging(data)
        if "time" not in data.given:
            return forms
        rests = dict.fromkeys([(), pauses(data)])
        until = np.inf if cls.of_measuring() else _last(data)
        return (*forms, *(cls(robot, constant, rest, until) for rest in rests for constant in WARM_UPS))

    @classmethod
    def asks(cls, robot: Robot, data: Measurements) -> tuple[str, ...]:
        """Return the unmet needs, among them times or temperatures that change."""
        shown = data.temperature_changes or "time" in data.given
        return (*super().asks(robot, data), *(() if shown else ("warmth",)))

    def later(self, series: Measurements | None) -> Self:
        """Return the same with the pauses of a series that has a clock of its own: it begins as warm as the fitted rows."""
        if series is None or not self.constant:
            return super().later(series)
        rests = pauses(series) or NEVER if self.pauses else ()
        return replace(self, pauses=rests, until=np.inf if self.of_measuring() else _last(series))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return time constants, or lags, about this one."""
        if not self.constant:
            return super().finer(data)
        return tuple(replace(self, constant=float(np.exp(log))) for log in around(np.log(self.constant), np.log(2)))

    @property
    def detail(self) -> str:
        """What it grows with."""
        if not self.constant:
            return f"with the temperature{self.late}"
        return f"{self.course} in {self.constant / 3600:.2g} h{', anew after each pause' if self.pauses else ''}"

    @property
    def variant(self) -> str:
        """Short name of the form, and whether there are pauses."""
        return super().variant + " anew" * bool(self.pauses)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Endings of the symbols of a part's parameters."""
        return ("", "0") if self.pauses else super().symbols

    def warmth(self, p: ca.SX, row: Row) -> ca.SX:
        """Return each part's parameters (parts after another) times the temperature above 20 degC [K] or the warm-up (0 to 1).

        It is structurally zero where a row has neither.
        """
        of_parameters = self._warmed_up(row) if self.constant else self.above_reference(row)
        return ca.reshape(p, len(of_parameters), -1).T @ ca.vertcat(*of_parameters)

    def _warmed_up(self, row: Row) -> list[ca.SX]:
        """Return the warm-up (0 to 1), and with pauses what is left of the heat at first; structurally zero without a time."""
        if not row.time.nnz():
            return [ca.SX(1, 1) for _ in self.symbols]
        risen = self._risen(row.time)
        for end, start in self.pauses:
            risen += self._risen(row.time - start) - self._risen(row.time - end)
        if np.isfinite(self.until):
            risen -= heat_lost(row.time - self.until, self.constant)[0]
        return [risen, 1 - self._risen(row.time)][: len(self.symbols)]

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
        return Variable("temperature above 20 degC", "K", lambda state, row: self.above_reference(row)[0])


def heat_lost(since: ca.SX, constant: float) -> tuple[ca.SX, ca.SX]:
    """Return mean and standard deviation of the heat that a robot has lost a time after it was last known to work [s].

    It works around the clock, or in shifts: then it stands from a random moment on (exponential), and cools with its constant.
    """
    passed, rate = ca.fmax(0, since), 1 / SHIFT

    def kept(fading: float) -> ca.SX:
        """Return the mean of exp(-fading · time for which it has stood), zero where it works."""
        faster = fading - rate
        if abs(faster) < ALIKE * rate:  # the limit of what follows
            return rate * passed * ca.exp(-rate * passed)
        return rate * (ca.exp(-rate * passed) - ca.exp(-fading * passed)) / faster

    stands = 1 - ca.exp(-rate * passed)
    mean = IN_SHIFTS * (stands - kept(1 / constant))
    square = IN_SHIFTS * (stands - 2 * kept(1 / constant) + kept(2 / constant))
    return mean, ca.sqrt(ca.fmax(0, square - mean**2))


def _last(data: Measurements) -> float:
    """Return the time of the last row [s]; infinite without times."""
    return float(data.table["time"].max()) if "time" in data.given else np.inf


def warmer(row: Row) -> ca.SX:
    """Return a row's temperature above 20 degC over WARMER, zero where it is unknown."""
    return (row.temperature - REFERENCE) / WARMER if row.temperature.nnz() else ca.SX(0)
