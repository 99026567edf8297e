"""Stand growth: a measuring device whose stand moves with the temperature, or as it settles or warms up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import OF_THE_FRAME, Words, displaced
from calflow.effects.warming import REFERENCE, Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SHIFT_SDS, TURN_SDS = (3e-4, 2e-5), (1e-4, 1e-5)  # when settled [m, rad]; per kelvin: of a stand of steel, 2 m high
BOUND = 100.0  # standard deviations


@dataclass(frozen=True)
class StandGrowth(Warming):
    """Reported position + (x, y, z) g, and with turning + g r x position, where g grows with T or with 1 - exp(-t / constant).

    g is zero at left, the mean temperature [K] or the last time [s] of the rows: the model's frame is that of the stand as it
    was left, and later measurements are in it.
    """

    turning: bool = False
    left: float = REFERENCE

    id = "stand-growth"
    title = "growth of the device's stand"
    words = Words(
        "growth of the device's stand", "the device's stand, or the robot's foot, follows the temperature, or settles"
    )
    readable = {"m/K": (1e6, "µm per °C"), "rad/K": (1e6, "µrad per °C")}
    whole = "device"
    family = OF_THE_FRAME
    taken_for = ()  # what it is mistaken for is of its family
    course = "settling"
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature or with a grid of time constants, without and with rotation."""
        shifting = tuple(growth._as_left(data) for growth in super().variants(robot, data))
        return (*shifting, *(replace(growth, turning=True) for growth in shifting))

    @classmethod
    def stated(cls, robot: Robot, data: Measurements) -> Self:
        """Return the growth with the temperature, from its mean on."""
        return cls(robot)._as_left(data)

    def _as_left(self, data: Measurements) -> Self:
        if self.constant:
            return replace(self, left=float(data.table["time"].max()))
        return replace(self, left=float(data.table["temperature"].mean())) if "temperature" in data.given else self

    @property
    def variant(self) -> str:
        """Short name of the form, without how it was left, which comes from the data."""
        return super(StandGrowth, replace(self, left=0.0)).variant

    @property
    def detail(self) -> str:
        """What it grows with, and whether it rotates."""
        return f"{super().detail}{', turned too' if self.turning else ''}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift, and the rotation."""
        per, form = ("", 0) if self.constant else ("/K", 1)
        kinds = [("", "m", SHIFT_SDS[form], "shift along"), ("r", "rad", TURN_SDS[form], "turn about")]
        return tuple(
            Parameter(self.id, "device", f"{symbol}{axis}{ending}", unit + per, sd, -BOUND * sd, BOUND * sd,
                      meaning=f"{meaning} {axis}")
            for symbol, unit, sd, meaning in kinds[: 2 if self.turning else 1] for axis in "xyz" for ending in self.symbols
        )  # fmt: skip

    def size(self, p: ca.SX) -> ca.SX:
        """Return the shift alone, without that at first."""
        return super(Warming, self).size(p[:: len(self.symbols)][:3])

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, displaced."""
        grown = self.warmth(p, row)
        if not grown.nnz():
            return point
        as_left = replace(row, **{"time" if self.constant else "temperature": ca.SX(self.left)})
        return point + displaced(grown - self.warmth(p, as_left), point)
