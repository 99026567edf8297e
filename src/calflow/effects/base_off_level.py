"""Base off level: gravity's direction differs from the robot file's, since the floor or wall is not level or upright."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words, joint_variable
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter

# A finished floor rises by up to 4 mm on 1 m (DIN 18202, table 3), about the span of a robot's foot.
TILT_SD, TILT_BOUND = 3e-3, 20e-3  # rad


@dataclass(frozen=True)
class BaseOffLevel(Effect):
    """Gravity g + w x g, w a small rotation about the two base axes across g.

    It acts through the loads alone (deflections change their direction): the base's measured pose has no information on it.
    """

    id = "base-off-level"
    title = "base off level"
    words = Words("tilt against gravity", "the base is not as level, or as upright, as the robot file says", "tilt")
    whole = "base"
    needs = ("masses",)
    told_by = "put a spirit level on the robot's foot"

    @cached_property
    def _across(self) -> tuple[int, ...]:
        """Indices of the two base axes nearest to perpendicular to gravity."""
        return tuple(sorted(np.argsort(np.abs(self.robot.gravity), kind="stable")[:2].tolist()))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the two rotations of gravity."""
        return tuple(
            Parameter(self.id, "base", f"r{'xyz'[axis]}", "rad", TILT_SD, -TILT_BOUND, TILT_BOUND,
                      meaning=f"tilt against gravity about {'xyz'[axis]}")
            for axis in self._across
        )  # fmt: skip

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return the loads with gravity rotated."""
        turn = ca.SX(3, 1)
        turn[list(self._across)] = p
        return replace(loads, gravity=loads.gravity + ca.cross(turn, loads.gravity))

    def variable(self, joint: int) -> Variable:
        """Return the angle of joint 1, which swings the arm towards and away from the tilt."""
        return joint_variable(self, 1)
