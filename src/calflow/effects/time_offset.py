"""Time offset: joints that were read earlier or later than the moving arm was measured."""

from __future__ import annotations

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
STILL = 1e-3  # rad/s, or m/s: an arm whose joints are nowhere faster is at rest


@dataclass(frozen=True)
class TimeOffset(Effect):
    """dq = t · speed + t² / 2 · acceleration: the arm was measured t after its joints were read, and turned on meanwhile."""

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
        """Say that the arm never moved."""
        fastest = np.abs(data.table[condition_columns("speed", robot)].to_numpy(float)).max(initial=0.0)
        return "" if fastest > STILL else "rows of an arm that moves"

    @classmethod
    def of_device(cls) -> bool:
        """Whether it is the measuring device's: it is, an arm at rest is where it would be without it."""
        return True

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the time."""
        return (
            Parameter(self.id, self.whole, "t", "s", SD, -BOUND, BOUND, meaning="by how much later it was measured"),
        )

    def size(self, p: ca.SX) -> ca.SX:
        """Return the time, negative where it was measured earlier."""
        return p[0]

    def variable(self, joint: int) -> Variable:
        """Return the speed of the fastest joint."""
        return Variable("speed of the fastest joint", "rad/s", lambda state, row: ca.norm_inf(row.speed))

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn the joints on."""
        if not row.speed.nnz():
            return still
        turned = p[0] * row.speed + p[0] ** 2 / 2 * row.acceleration
        return replace(still, joint=ca.DM(self.robot.reading_matrix) @ turned)
