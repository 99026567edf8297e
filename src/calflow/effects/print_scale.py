"""Print scale: a camera target printed longer in one direction than in the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.of_images import OfImages
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter

SD, BOUND = 5e-3, 0.05


@dataclass(frozen=True)
class PrintScale(OfImages):
    """Target's point times (1 + x, 1 + y, 1).

    Its size is y - x, which images determine. The common part of x and y is confounded with a scale of all lengths of robot
    and set-up, so that each alone is only as certain as the prior on the robot's lengths makes it.
    """

    id = "print-scale"
    title = "print that is longer one way"
    words = Words(
        "print that is longer one way", "the printer stretched the board", "how much longer it is along y than along x"
    )
    whole = "target"
    told_by = "measure the print along both directions"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the scale error of each direction."""
        return tuple(
            Parameter(self.id, self.whole, axis, "1", SD, -BOUND, BOUND, meaning=f"scale of the print along {axis}")
            for axis in "xy"
        )

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the scale along y relative to that along x."""
        return p[1] - p[0]

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, scaled."""
        return point * (1 + self.mine(row) * ca.vertcat(p, 0))
