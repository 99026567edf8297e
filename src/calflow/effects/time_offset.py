"""Time offset: joint readings taken earlier or later than the position of the moving arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import condition_columns
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SD, BOUND = 10e-3, 0.5  # s
STILL = 1e-3  # rad/s, or m/s: below it, an arm counts as at rest


@dataclass(frozen=True)
class TimeOffset(Effect):
    """dq = t · speed + t² / 2 · acceleration: the arm moved on for t between the reading of its joints and the measurement."""

    id = "time-offset"
    title = "time offset of joints and measurement"
    words = Words(
        "time offset",
        "the arm was measured later, or earlier, than its joints were read; its size holds where these keep their acceleration",
        "how much later",
    )
    readable = {"s": (1e3, "ms")}
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

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the time offset."""
        return (
            Parameter(self.id, self.whole, "t", "s", SD, -BOUND, BOUND, meaning="by how much later it was measured"),
        )

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the time offset, negative if the arm was measured before its joints were read."""
        return p[0]

    def variable(self, joint: int) -> Variable:
        """Return the speed of the fastest joint."""
        return Variable("speed of the fastest joint", "rad/s", lambda state, row: ca.norm_inf(row.speed))

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the motion of the joints during the offset."""
        if not row.speed.nnz():
            return still
        turned = p[0] * row.speed + p[0] ** 2 / 2 * row.acceleration
        return replace(still, joint=ca.DM(self.robot.reading_matrix) @ turned)
