"""Frame drift: a measuring device that wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca

from calflow.conditions import Row
from calflow.effects.base import Effect, Parameter, Variable
from calflow.robot.description import Robot

if TYPE_CHECKING:
    from calflow.measurements import Measurements

WANDERS_SD, TURNS_SD = 1e-7, 3e-8  # m/s and rad/s: some tenths of a millimetre an hour
BOUND = 100.0  # standard deviations


@dataclass(frozen=True)
class FrameDrift(Effect):
    """Reported position + v t, and with turning + w t x position (about the measuring frame's origin)."""

    turning: bool = False

    id: ClassVar[str] = "frame-drift"
    title: ClassVar[str] = "drift of the measuring device"
    needs: ClassVar[tuple[str, ...]] = ("time",)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return drift without and with turning."""
        return cls(robot), cls(robot, True)

    @property
    def detail(self) -> str:
        """Say whether it turns."""
        return "shifting and turning" if self.turning else "shifting"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the velocities."""
        kinds = [("v", "m/s", WANDERS_SD), *([("w", "rad/s", TURNS_SD)] if self.turning else [])]
        return tuple(
            Parameter(self.id, "device", symbol + axis, unit, sd, -BOUND * sd, BOUND * sd, meaning=f"drift {symbol}{axis}")
            for symbol, unit, sd in kinds for axis in "xyz"
        )  # fmt: skip

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        if not row.time.nnz():
            return point
        shift = p[:3] + (ca.cross(p[3:], point) if self.turning else 0)
        return point + shift * row.time

    def variable(self, joint: int) -> Variable:
        """Return the time."""
        return Variable("time", "h", lambda state, row: row.time, 1 / 3600)
