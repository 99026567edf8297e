"""Frame drift: a measuring device that wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca

from calflow.effects.base import Effect, Variable, Words, displaced
from calflow.robot.conditions import Row
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements

WANDERS_SD, TURNS_SD = 1e-7, 3e-8  # m/s and rad/s: some tenths of a millimetre an hour
SHIFT_SD, TURN_SD = 3e-4, 1e-4  # m and rad in all
BOUND = 100.0  # standard deviations


@dataclass(frozen=True)
class FrameDrift(Effect):
    """Reported position + v t, and with turning + w t x position (about the measuring frame's origin).

    Where the time is not known, t is the share of all rows that have been measured, and rows is their number (0: time).
    """

    turning: bool = False
    rows: float = 0.0

    id: ClassVar[str] = "frame-drift"
    title: ClassVar[str] = "drift of the measuring device"
    words: ClassVar[Words] = Words(
        "drift of the measuring device", "the device wanders steadily while measuring", "speed"
    )
    whole: ClassVar[str] = "device"
    told_by: ClassVar[str] = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return drift without and with turning."""
        rows = 0.0 if "time" in data.given else float(data.table["order"].max())
        return cls(robot, False, rows), cls(robot, True, rows)

    @classmethod
    def lacking(cls, robot: Robot, data: Measurements) -> str:
        """Say that neither time nor order is known."""
        return "" if {"time", "order"} & set(data.given) else "a column time_s"

    @property
    def detail(self) -> str:
        """Say whether it turns."""
        how = "shifting and turning" if self.turning else "shifting"
        return f"{how}, by the order of the rows" if self.rows else how

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the velocities."""
        per = "" if self.rows else "/s"
        sds = (SHIFT_SD, TURN_SD) if self.rows else (WANDERS_SD, TURNS_SD)
        kinds = list(zip(("v", "w"), (f"m{per}", f"rad{per}"), sds, strict=True))[: 2 if self.turning else 1]
        return tuple(
            Parameter(self.id, "device", symbol + axis, unit, sd, -BOUND * sd, BOUND * sd, meaning=f"drift {symbol}{axis}")
            for symbol, unit, sd in kinds for axis in "xyz"
        )  # fmt: skip

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        passed = row.order / self.rows if self.rows else row.time
        if not passed.nnz():
            return point
        return point + displaced(p, point) * passed

    def variable(self, joint: int) -> Variable:
        """Return the time, or the order of the rows."""
        if self.rows:
            return super().variable(joint)
        return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
