"""Frame step: a measuring device, or a robot, that was bumped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.conditions import Row
from calflow.effects.base import Effect, Parameter
from calflow.robot.description import Robot

if TYPE_CHECKING:
    from calflow.measurements import Measurements

MOMENTS = 120  # at most, that are looked at
FEWEST = 3  # rows before the first moment and after the last


@dataclass(frozen=True)
class FrameStep(Effect):
    """Reported position + (x, y, z) from a row on."""

    moment: float = 0.5

    id: ClassVar[str] = "frame-step"
    title: ClassVar[str] = "step of the measuring device"
    needs: ClassVar[tuple[str, ...]] = ("order",)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return moments between the rows."""
        places = np.unique(data.table["order"].to_numpy())
        between = (places[1:] + places[:-1])[FEWEST - 1 : len(places) - FEWEST] / 2
        chosen = between[np.unique(np.linspace(0, len(between) - 1, MOMENTS).astype(int))] if len(between) else between
        return tuple(cls(robot, float(moment)) for moment in chosen)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one that were left out."""
        places = np.unique(data.table["order"].to_numpy())
        between = ((places[1:] + places[:-1]) / 2)[FEWEST - 1 : len(places) - FEWEST]
        reach = max(1.0, float(np.ptp(places)) / MOMENTS)
        return tuple(type(self)(self.robot, float(m)) for m in between[np.abs(between - self.moment) <= reach])

    @property
    def detail(self) -> str:
        """Say when."""
        return f"after row {int(np.floor(self.moment))} in measuring order"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the step."""
        return tuple(
            Parameter(self.id, "device", axis, "m", 3e-4, -0.1, 0.1, meaning=f"step along {axis}") for axis in "xyz"
        )

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported after the moment."""
        return point + p * (row.order > self.moment) if row.order.nnz() else point
