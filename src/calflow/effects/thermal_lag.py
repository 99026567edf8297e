"""Thermal lag: base class of effects of the temperature of a structure, which follows the air's as one heat capacity does."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, around
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row

REFERENCE = 293.15  # K: reference temperature of drawings (ISO 1)
LAGS = (900.0, 1800.0, 3600.0, 7200.0)  # s: time constants searched
AT_FIRST = 3.0  # K: by which a structure may differ from the air at the first row
RESOLVED = 20.0  # knots in a time constant: between them it is straight to a few mK
LONG = 1e8  # s: in which any structure has become as warm as its air


@dataclass(frozen=True)
class ThermalLag(Effect):
    """An effect of a temperature T that follows the air's with a time constant, lag [s]: dT/dt = (T_air - T) / lag; 0: the air's.

    followed is T over time, (s, K) at each knot, where the air's is linear between rows, and T the air's at the first one. What T
    differs by at first fades with the constant, and is a parameter beside each other one. After the last knot the air is taken to
    be as a row states; where a row has no time, T is the air's.
    """

    lag: float = field(default=0.0, kw_only=True)
    followed: tuple[tuple[float, float], ...] = field(default=(), kw_only=True, repr=False)

    unnamed: ClassVar[tuple[str, ...]] = ("followed",)

    def lagging(self, data: Measurements) -> tuple[Self, ...]:
        """Return the effect with the temperature, and with each lag where times are known; nothing where it does not change."""
        if not data.temperature_changes:
            return ()
        return (self, *(self._behind(lag, data) for lag in LAGS if "time" in data.given))

    def _behind(self, lag: float, data: Measurements, begun: float = 0.0) -> Self:
        return replace(self, lag=lag, followed=followed(data, lag, begun))

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return lags about this one."""
        if not self.lag:
            return ()
        return tuple(self._behind(float(self.lag * np.exp(log)), data) for log in around(0.0, np.log(2)))

    def later(self, series: Measurements | None) -> Self:
        """Return the same of a series with a clock of its own, at whose first row it has long been as warm as the air."""
        if series is None or not self.lag:
            return self
        known = {"time", "temperature"} <= set(series.given)
        return self._behind(self.lag, series, LONG) if known else replace(self, followed=())

    @property
    def late(self) -> str:
        """How late it follows the air, in words."""
        return f", {self.lag / 3600:.2g} h late" if self.lag else ""

    @property
    def symbols(self) -> tuple[str, ...]:
        """Endings of the symbols of a part's parameters."""
        return ("", "0") if self.lag else ("",)

    def above_reference(self, row: Row) -> list[ca.SX]:
        """Return T - 20 degC [K], and with a lag what fades of AT_FIRST; structurally zero where the temperature is unknown."""
        if not row.temperature.nnz():
            return [ca.SX(1, 1) for _ in self.symbols]
        if not (self.followed and row.time.nnz()):
            return [row.temperature - REFERENCE, ca.SX(1, 1)][: len(self.symbols)]
        time, known = np.array(self.followed).T
        bends = np.diff(np.diff(known) / np.diff(time), prepend=0.0)
        passed = ca.fmin(row.time, time[-1]) - ca.DM(time[:-1])
        then = known[0] + ca.dot(ca.DM(bends), ca.fmax(0, passed))
        since = ca.exp(-ca.fmax(0, row.time - time[-1]) / self.lag)
        fades = ca.exp(-ca.fmax(0, row.time - time[0]) / self.lag)
        return [row.temperature + (then - row.temperature) * since - REFERENCE, AT_FIRST * fades]


def followed(data: Measurements, lag: float, begun: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Return times [s] and temperatures [K] of what follows the air's with a time constant, as warm as it at the first row.

    Its first knot is a time before that.
    """
    air = data.table.groupby("time")["temperature"].mean()
    time, temperature = air.index.to_numpy(float), air.to_numpy(float)
    now, known = temperature[0], [temperature[0]]
    for passed, before, after in zip(np.diff(time), temperature[:-1], temperature[1:], strict=True):
        behind = (after - before) * lag / passed  # what has followed a steady rise for long
        now = after - behind + (now - before + behind) * np.exp(-passed / lag)
        known.append(now)
    unit = np.floor(time * RESOLVED / lag)
    kept = np.diff(unit, prepend=-np.inf) + np.diff(unit, append=np.inf) > 0  # the first and the last in each
    first = [(time[0] - begun, known[0])] * bool(begun)
    return (*first, *((float(t), float(k)) for t, k in zip(time[kept], np.array(known)[kept], strict=True)))
