"""Frame drift: a measuring device that wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import casadi as ca

from calflow.effects.base import IN_TIME, MARGIN, OF_THE_FRAME, RMS, Effect, Variable, Words, displaced, waves
from calflow.measurements.measurements import Measurements, sessions_of
from calflow.robot.mechanism import Row, session_number
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

WANDERS_SD, TURNS_SD = 1e-7, 3e-8  # m/s and rad/s: some tenths of a millimetre an hour
SHIFT_SD, TURN_SD = 3e-4, 1e-4  # m and rad in all
BOUND = 100.0  # standard deviations
CURVE_SD = 1e-4  # m rms along an axis, of a curve in time
LENGTHS = (0.5, 0.15)  # of all the time: how far apart the device is alike
RESOLVED = 0.5  # of a length


@dataclass(frozen=True)
class FrameDrift(Effect):
    """Reported position + v t, and with turning + w t x position (about the measuring frame's origin).

    Where the time is not known, t is the share of all rows that have been measured, and rows is their number (0: time).
    sessions are those with each of which t begins anew, at starts [s, or share]. Where a length is given, the position is
    shifted by a smooth curve of t from 0 to end instead, alike over that share of it; sessions are those that were measured
    meanwhile. Where the device stands in another one, or later, nobody knows: as it did on average.
    """

    turning: bool = False
    rows: float = 0.0
    sessions: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    length: float = 0.0
    end: float = 0.0

    id = "frame-drift"
    title = "drift of the measuring device"
    words = Words("drift of the measuring device", "the device wanders while measuring", "drift")
    whole = "device"
    family = OF_THE_FRAME
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return drift without and with turning, from the beginning and anew with each session, and curves in time."""
        rows = 0.0 if "time" in data.given else float(data.table["order"].max())
        passed = data.table["order"] / rows if rows else data.table["time"]
        end = float(passed.max())
        steady = [cls(robot, turning, rows) for turning in (False, True)]
        if len(sessions := sessions_of(data)) > 1:
            starts = passed.groupby(data.table["session"].astype(str)).min()
            first = tuple(float(starts[session]) for session in sessions)
            steady += [cls(robot, turning, rows, sessions, first) for turning in (False, True)]
        curves = (cls(robot, rows=rows, sessions=sessions, length=length, end=end) for length in LENGTHS if end > 0)
        return (*steady, *curves)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Say that neither time nor order is known."""
        return "" if {"time", "order"} & set(data.given) else "a column time_s"

    @property
    def detail(self) -> str:
        """Say whether it is steady, whether it turns, and what it goes by."""
        how = "shifting and turning" if self.turning else "shifting"
        if self.length:
            how = f"wandering, alike over {self.length:.0%} of the time"
        anew = ", anew in each session" if self.starts else ""
        return f"{how}{anew}{', by the order of the rows' if self.rows else ''}"

    @property
    def variant(self) -> str:
        """Name its form; when sessions start and how long it took are the data's."""
        words = (
            "turning" if self.turning else "",
            f"rows {self.rows:.8g}" if self.rows else "",
            "by session" if self.starts else "",
            f"length {self.length:g}" if self.length else "",
        )
        return " ".join(filter(None, words))

    @property
    def smooth_in(self) -> tuple[str, ...]:
        """Time and order, where it is a curve."""
        return IN_TIME if self.length else ()

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the velocities, or the waves of the curve along each axis."""
        if self.length:
            return tuple(
                Parameter(self.id, "device", f"wave{wave.number}{axis}", "m", CURVE_SD * wave.sd, -0.05, 0.05,
                          meaning=f"wave {wave.number} along {axis}")
                for wave in waves(ca.SX.sym("t"), 0.0, 1.0, self.length, RESOLVED * self.length) for axis in "xyz"
            )  # fmt: skip
        per = "" if self.rows else "/s"
        sds = (SHIFT_SD, TURN_SD) if self.rows else (WANDERS_SD, TURNS_SD)
        kinds = list(zip(("v", "w"), (f"m{per}", f"rad{per}"), sds, strict=True))[: 2 if self.turning else 1]
        return tuple(
            Parameter(self.id, "device", symbol + axis, unit, sd, -BOUND * sd, BOUND * sd, meaning=f"drift {symbol}{axis}")
            for symbol, unit, sd in kinds for axis in "xyz"
        )  # fmt: skip

    def size(self, p: ca.SX) -> ca.SX:
        """Return the speed, or a curve's root mean square."""
        return super().size(p) * (RMS if self.length else 1.0)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        passed = self._passed(row)
        if not passed.nnz():
            return point
        if self.length:
            curve = waves(passed / self.end, 0.0, 1.0, self.length, RESOLVED * self.length)
            named = [row.session == session_number(name) for name in self.sessions if row.session.nnz()]
            # The share of the way on which waves come to zero, so that a row a moment later is where the last one was.
            beyond = ca.fmin(1, ca.fmax(0, 2 * (passed / self.end - 1) / (MARGIN - 1)))
            there = sum(named) if named else 1
            values = [there * wave.value + (1 - there * (1 - beyond)) * wave.mean for wave in curve]
            return point + ca.reshape(p, 3, len(curve)) @ ca.vertcat(*values)
        return point + displaced(p, point) * passed

    def _passed(self, row: Row) -> ca.SX:
        """The time, or the share of the rows, since the beginning; nothing in a session whose beginning nobody knows."""
        passed = row.order / self.rows if self.rows else row.time
        if not self.starts or not passed.nnz():
            return passed
        starts = zip(self.sessions, self.starts, strict=True)
        return sum(((row.session == session_number(name)) * (passed - start) for name, start in starts), ca.SX(0))

    def variable(self, joint: int) -> Variable:
        """Return the time, or the order of the rows."""
        if self.rows:
            return super().variable(joint)
        return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
