"""Board bent: a camera target whose plate is not flat."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.effects.base import Words
from calflow.effects.of_images import OfImages
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

REACH = 0.1  # m from the plate's centre, where its deviation from a plane is stated
SD, BOUND = 3e-4, 10e-3  # m
FLAT = 1e-4  # m: range of z beyond which the points are those of a solid, not of a plate


@dataclass(frozen=True)
class BoardBent(OfImages):
    """Height of a target's point + (xx x² + xy x y + yy y²) / (0.1 m)²; lower orders belong to the target's pose."""

    id = "board-bent"
    title = "board that is not flat"
    words = Words("board that is not flat", "the plate is bowed or twisted", "height at 0.1 m from its middle")
    whole = "target"
    told_by = "lay a straight edge on the plate, along it, across it and from corner to corner"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where the images are not of a flat target."""
        if unfit := super().unfit(robot, data):
            return unfit
        ranges = data.table.groupby(data.imaged(cls.whole))["px_z"].agg(np.ptp)
        return "" if ranges.min() < FLAT else "a target whose points lie in a plane"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the heights at 0.1 m along x and y, and that of the twist."""
        return tuple(
            Parameter(
                self.id, self.whole, symbol, "m", SD, -BOUND, BOUND, meaning=f"height by {symbol[0]} · {symbol[1]}"
            )
            for symbol in ("xx", "xy", "yy")
        )

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, raised by the plate's deviation from its plane."""
        return point + ca.vertcat(0, 0, self.mine(row) * bow(p, point))


def bow(p: ca.SX, point: ca.SX) -> ca.SX:
    """Return the height [m] of a bowed plate at a target's point, given its coefficients p = (xx, xy, yy) at REACH [m]."""
    x, y = point[0] / REACH, point[1] / REACH
    return p[0] * x * x + p[1] * x * y + p[2] * y * y
