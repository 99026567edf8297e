"""Frame step: a measuring device, or a robot, that was bumped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Words, displaced
from calflow.effects.frame_drift import OF_THE_FRAME
from calflow.measurements.measurements import Measurements, borders
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

MOMENTS, TURNING_MOMENTS = 120, 40  # at most, that are looked at: without turning, and with
SHIFT_SD, TURN_SD, BOUND = 3e-4, 1e-4, 300.0  # m, rad, and standard deviations
FEWEST = 3  # rows before the first moment and after the last


@dataclass(frozen=True)
class FrameStep(Effect):
    """Reported position + (x, y, z), and with turning + r x position (about the measuring frame's origin), from a row on.

    Where rows are of several sessions, what changes between two of them is the frame of a session (see `session_frame`).
    """

    moment: float = 0.5
    turning: bool = False

    id = "frame-step"
    title = "step of the measuring device"
    words = Words("step of the measuring device", "the device, or the robot's foot, was moved once", "step")
    whole = "device"
    family = OF_THE_FRAME
    needs = ("order",)
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return moments between the rows, without and with turning."""
        between = _moments(data)
        return tuple(
            cls(robot, float(moment), turning)
            for turning, most in ((False, MOMENTS), (True, TURNING_MOMENTS))
            for moment in _spread(between, most)
        )

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one that were left out."""
        between = _moments(data)
        tried = _spread(between, TURNING_MOMENTS if self.turning else MOMENTS)
        reach = float(np.diff(tried).max(initial=1.0))
        return tuple(replace(self, moment=float(m)) for m in between[np.abs(between - self.moment) <= reach])

    def same_as(self, other: Self) -> bool:
        """Return whether the moments are too near for two steps."""
        return abs(other.moment - self.moment) < FEWEST

    @property
    def detail(self) -> str:
        """Say when, and whether it turned."""
        return f"after row {int(np.floor(self.moment))} in measuring order{', turned too' if self.turning else ''}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the step, and the turn."""
        kinds = [("", "m", SHIFT_SD, "step along"), *([("r", "rad", TURN_SD, "turn about")] if self.turning else [])]
        return tuple(
            Parameter(self.id, "device", symbol + axis, unit, sd, -BOUND * sd, BOUND * sd, meaning=f"{meaning} {axis}")
            for symbol, unit, sd, meaning in kinds for axis in "xyz"
        )  # fmt: skip

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported after the moment."""
        if not row.order.nnz():
            return point
        return point + displaced(p, point) * (row.order > self.moment)


def _moments(data: Measurements) -> np.ndarray:
    """All moments between the rows of a session that leave FEWEST before and after."""
    places = np.unique(data.table["order"].to_numpy())
    between = ((places[1:] + places[:-1]) / 2)[FEWEST - 1 : len(places) - FEWEST]
    return np.asarray(between[~np.isin(between, borders(data))])


def _spread(moments: np.ndarray, most: int) -> np.ndarray:
    """Some of the moments, evenly."""
    return moments[np.unique(np.linspace(0, len(moments) - 1, most).astype(int))] if len(moments) else moments
