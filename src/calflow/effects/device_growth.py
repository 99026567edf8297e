"""Growth of the measuring device: a stand that moves, or a camera's lens that changes, with the temperature or as it warms up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import LENS, OF_THE_FRAME, Words, displaced, refocused, several_imaged
from calflow.effects.warming import REFERENCE, Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SHIFT_SDS, TURN_SDS = (3e-4, 2e-5), (1e-4, 1e-5)  # when settled [m, rad]; per kelvin: of a stand of steel, 2 m high
LENS_SDS = (1e-3, 5e-5)  # when warm; per kelvin: of the focal length, a pixel or two at the edge of an image
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
        shifting = cls._left(robot, data)
        return (*shifting, *(replace(growth, turning=True) for growth in shifting))

    @classmethod
    def _left(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        return tuple(growth._as_left(data) for growth in super().variants(robot, data))

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

    @property
    def changes(self) -> list[tuple[str, str, float, str]]:
        """Symbol, unit, usual size and meaning of each change of what is reported."""
        form = 0 if self.constant else 1
        kinds = [("", "m", SHIFT_SDS[form], "shift along"), ("r", "rad", TURN_SDS[form], "turn about")]
        return [
            (symbol + axis, unit, sd, f"{meaning} {axis}")
            for symbol, unit, sd, meaning in kinds[: 2 if self.turning else 1] for axis in "xyz"
        ]  # fmt: skip

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the changes, and those at first where the device warms up again after pauses."""
        per = "" if self.constant else "/K"
        return tuple(
            Parameter(self.id, "device", symbol + ending, unit + per, sd, -BOUND * sd, BOUND * sd, meaning=meaning)
            for symbol, unit, sd, meaning in self.changes for ending in self.symbols
        )  # fmt: skip

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the shift alone, without that at first."""
        return super(Warming, self).size(p[:: len(self.symbols)][:3], own[:: len(self.symbols)][:3])

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, displaced."""
        grown = self.warmth(p, row)
        if not grown.nnz():
            return point
        as_left = replace(row, **{"time" if self.constant else "temperature": ca.SX(self.left)})
        return point + self.change(grown - self.warmth(p, as_left), point)

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return a point's displacement (3,)."""
        return displaced(p, point)


@dataclass(frozen=True)
class LensGrowth(StandGrowth):
    """Focal lengths times 1 + f g, the image's centre + (x, y) g focal lengths, where g grows with T or 1 - exp(-t / constant).

    g is zero where the camera was left, as of the stand's growth.
    """

    id = "lens-growth"
    title = "growth of the camera's lens"
    words = Words(
        "growth of the camera's lens", "the lens or the sensor follows the temperature, or warms up", "relative change"
    )
    course = "warming up"
    imaged = True
    told_by = "let the camera warm up first, or photograph a target fixed beside it from time to time"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where the rows are not images of one camera."""
        return several_imaged(data, "camera")

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature or with a grid of time constants; none for unsuitable data."""
        return () if cls.lacking(robot, data) else cls._left(robot, data)

    @property
    def changes(self) -> list[tuple[str, str, float, str]]:
        """Those of the focal lengths, and of the image's centre."""
        return [
            (symbol, "1", LENS_SDS[0 if self.constant else 1], f"growth of the {meaning}") for symbol, meaning in LENS
        ]

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return the displacement (3,) of a point in the camera's frame that changes its image alike."""
        return refocused(p, point)
