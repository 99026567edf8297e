"""Print scale: a printer that made a board longer one way than the other."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Effect, Words, several_imaged
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SD, BOUND = 5e-3, 0.05


@dataclass(frozen=True)
class PrintScale(Effect):
    """Target's point times (1 + x, 1 + y, 1).

    Its size is y - x, which images tell. What x and y have in common is a scale of all lengths, robot's and places', and no image
    tells it from these: both are then as unsure as what is known of the robot's lengths leaves them.
    """

    id = "print-scale"
    title = "print that is longer one way"
    words = Words(
        "print that is longer one way", "the printer stretched the board", "how much longer it is along y than along x"
    )
    whole = "target"
    shown_by = "images"
    told_by = "measure the print along both directions"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Say that rows are not of one board."""
        return several_imaged(data, "target")

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the error of each direction."""
        return tuple(
            Parameter(self.id, self.whole, axis, "1", SD, -BOUND, BOUND, meaning=f"scale of the print along {axis}")
            for axis in "xy"
        )

    def size(self, p: ca.SX) -> ca.SX:
        """Return by how much it is longer along y."""
        return p[1] - p[0]

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Stretch the print."""
        return point * ca.vertcat(1 + p[0], 1 + p[1], 1)
