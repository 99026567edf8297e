"""Frame drift: a measuring device whose frame drifts, at constant velocity or as a smooth curve in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca

from calflow.effects.base import IN_TIME, OF_THE_FRAME, Effect, Variable, Words
from calflow.effects.displacement import displaced
from calflow.effects.smooth_curve import MARGIN, RMS, waves
from calflow.measurements.measurements import Measurements, pauses, sessions_of
from calflow.robot.mechanism import Row, name_number
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

WANDERS_SD, TURNS_SD = 1e-7, 3e-8  # m/s and rad/s: some tenths of a millimetre per hour
SHIFT_SD, TURN_SD = 3e-4, 1e-4  # m and rad over all rows
BOUND = 100.0  # standard deviations
CURVE_SD = 1e-4  # m rms per axis, of a curve in time
LENGTHS = (0.5, 0.15)  # correlation lengths, as shares of the measuring time
RESOLVED = 0.5  # finest wavelength resolved, as a share of the correlation length


@dataclass(frozen=True)
class FrameDrift(Effect):
    """Reported position + v t, and with turning + w t x position (about the measuring frame's origin).

    Where the time is unknown, t is the share of all rows measured so far, and rows is their number (0: time is known). With
    starts [s, or share], t restarts in each of the sessions. With a length, a correlation length as a share of the time, the
    shift is a smooth curve of t from 0 to end instead, in the sessions measured meanwhile, and t stands still in pauses, each from
    a time to another one [s]: else what happens within a day is beyond a curve over several. It is about its mean, which no data
    tell from the station: later, or in any other session, the device is taken to stand where it stood on average.
    """

    turning: bool = False
    rows: float = 0.0
    sessions: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    length: float = 0.0
    end: float = 0.0
    pauses: tuple[tuple[float, float], ...] = ()

    id = "frame-drift"
    title = "drift of the measuring set-up"
    words = Words("drift of the measuring set-up", "the device, or what is touched, wanders while measuring", "drift")
    whole = "device"
    family = OF_THE_FRAME
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return drifts without and with rotation, from the beginning or restarting per session, and curves in time."""
        rows = 0.0 if "time" in data.given else float(data.table["order"].max())
        passed = data.table["order"] / rows if rows else data.table["time"]
        end = float(passed.max())
        steady = [cls(robot, turning, rows) for turning in (False, True)]
        if len(sessions := sessions_of(data)) > 1:
            starts = passed.groupby(data.session).min()
            first = tuple(float(starts[session]) for session in sessions)
            steady += [cls(robot, turning, rows, sessions, first) for turning in (False, True)]
        curves = (
            cls(robot, rows=rows, sessions=sessions, length=length, end=end - sum(b - a for a, b in rests), pauses=rests)
            for rests in dict.fromkeys([(), pauses(data)]) for length in LENGTHS if end > 0
        )  # fmt: skip
        return (*steady, *curves)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return the missing column where neither time nor order is known."""
        return "" if {"time", "order"} & set(data.given) else "a column time_s"

    @property
    def detail(self) -> str:
        """Whether it is steady or a curve, whether it rotates, and what it is a function of."""
        how = "shifting and turning" if self.turning else "shifting"
        if self.length:
            how = f"wandering, alike over {self.length:.0%} of the time{' without pauses' if self.pauses else ''}"
        anew = ", anew in each session" if self.starts else ""
        return f"{how}{anew}{', by the order of the rows' if self.rows else ''}"

    @property
    def variant(self) -> str:
        """Short name of the form, without the sessions' starts and the duration, which come from the data."""
        words = (
            "turning" if self.turning else "",
            f"rows {self.rows:.8g}" if self.rows else "",
            "by session" if self.starts else "",
            f"length {self.length:g}" if self.length else "",
            "without pauses" if self.pauses else "",
        )
        return " ".join(filter(None, words))

    @property
    def smooth_in(self) -> tuple[str, ...]:
        """Time and order, if it is a curve."""
        return IN_TIME if self.length else ()

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the velocities, or the basis amplitudes of the curve along each axis."""
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

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the speed, or a curve's root mean square."""
        return super().size(p, own) * (RMS if self.length else 1.0)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, displaced by the drift."""
        passed = self._passed(row)
        if not passed.nnz():
            return point
        if self.length:
            curve = waves(passed / self.end, 0.0, 1.0, self.length, RESOLVED * self.length)
            named = [row.session == name_number(name) for name in self.sessions if row.session.nnz()]
            # Blends to zero over the margin in which the waves do, so that the shift stays continuous.
            beyond = ca.fmin(1, ca.fmax(0, 2 * (passed / self.end - 1) / (MARGIN - 1)))
            there = sum(named) if named else 1
            values = [there * (wave.value - (1 - beyond) * wave.mean) for wave in curve]
            return point + ca.reshape(p, 3, len(curve)) @ ca.vertcat(*values)
        return point + displaced(p, point) * passed

    def _passed(self, row: Row) -> ca.SX:
        """Return the time, or share of rows, since the (session's) start; zero in a session whose start is unknown."""
        passed = row.order / self.rows if self.rows else row.time
        for begin, end in self.pauses if passed.nnz() else ():
            passed -= ca.fmin(ca.fmax(row.time - begin, 0), end - begin)
        if not self.starts or not passed.nnz():
            return passed
        starts = zip(self.sessions, self.starts, strict=True)
        return sum(((row.session == name_number(name)) * (passed - start) for name, start in starts), ca.SX(0))

    def variable(self, joint: int) -> Variable:
        """Return the time, or the order of the rows."""
        if self.rows:
            return super().variable(joint)
        return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
