"""Time offset: joint readings taken earlier or later than the position of the moving arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import condition_columns
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SD, BOUND = 10e-3, 0.5  # s
LINE_SD, LINE_BOUND = 3e-5, 1e-3  # s/px: 30 ms for an image of 1000 rows
STILL = 1e-3  # rad/s, or m/s: below it, an arm counts as at rest


@dataclass(frozen=True)
class TimeOffset(Effect):
    """dq = t · speed + t² / 2 · acceleration: the arm moved on for t between the reading of its joints and the measurement.

    A rolling shutter exposes an image's rows one after the other: t is that of the first row, and grows by a row's time each.
    """

    shutter: str = ""

    id = "time-offset"
    title = "time offset of joints and measurement"
    forms = {"": "", "rolling": "an image's rows one after the other"}
    words = Words(
        "time offset",
        "the arm was measured later, or earlier, than its joints were read; its size holds where these keep their acceleration",
        "how much later",
    )
    readable = {"s": (1e3, "ms"), "s/px": (1e6, "µs/px")}
    whole = "device"
    needs = ("speed",)
    told_by = "measure some poses at rest too, or trigger joints and device by one signal"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is required where the arm never moved."""
        fastest = np.abs(data.table[condition_columns("speed", robot)].to_numpy(float)).max(initial=0.0)
        return "" if fastest > STILL else "rows of an arm that moves"

    @classmethod
    def of_measuring(cls) -> bool:
        """Whether it belongs to the measuring: it does, since an arm at rest does not show it."""
        return True

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return its forms, a rolling shutter's for images alone."""
        return tuple(form for form in super().variants(robot, data) if not form.shutter or "image_row" in data.given)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the time from row to row of a rolling shutter, and the time offset."""
        line = Parameter(
            self.id, self.whole, "line", "s/px", LINE_SD, -LINE_BOUND, LINE_BOUND, meaning="from row to row"
        )
        late = Parameter(self.id, self.whole, "t", "s", SD, -BOUND, BOUND, meaning="by how much later it was measured")
        return (line, late) if self.shutter else (late,)

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the time offset, negative if the arm was measured before its joints were read; of rows that from row to row."""
        return p[0]

    def variable(self, joint: int) -> Variable:
        """Return the speed of the fastest joint."""
        return Variable("speed of the fastest joint", "rad/s", lambda state, row: ca.norm_inf(row.speed))

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the motion of the joints during the offset."""
        if not row.speed.nnz():
            return still
        late = p[1] + p[0] * row.image_row if self.shutter else p[0]
        turned = late * row.speed + late**2 / 2 * row.acceleration
        return replace(still, joint=ca.DM(self.robot.reading_matrix) @ turned)
