"""Growth of the measuring device: a stand that moves, or a scale or a lens that changes, with the temperature or as it warms up."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import LENS, OF_THE_FRAME, Words, displaced, refocused
from calflow.effects.of_images import OfImages
from calflow.effects.warming import REFERENCE, Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SHIFT_SDS, TURN_SDS = (3e-4, 2e-5), (1e-4, 1e-5)  # when settled [m, rad]; per kelvin: of a stand of steel, 2 m high
SCALE_SDS = (5e-5, 1e-5)  # when warm; per kelvin: of steel, ten times as much as of a beam in air
LENS_SDS = (1e-3, 5e-5)  # when warm; per kelvin: of the focal length, a pixel or two at the edge of an image
BOUND = 100.0  # standard deviations


@dataclass(frozen=True)
class DeviceGrowth(Warming):
    """A change of what the device reports, times g, which grows with T or with 1 - exp(-t / constant).

    g is zero at left, the mean temperature [K] or the last time [s] of the rows: the model's frame is that of the device as it
    was left, and later measurements are in it.
    """

    left: float = REFERENCE

    unnamed = (*Warming.unnamed, "left")
    whole = "device"
    family = OF_THE_FRAME
    taken_for = ()  # what it is mistaken for is of its family

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature or with a grid of time constants."""
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
    @abstractmethod
    def changes(self) -> list[tuple[str, str, float, str]]:
        """Symbol, unit, usual size and meaning of each change of what is reported."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the changes, and those at first where the device warms up again after pauses."""
        per = "" if self.constant else "/K"
        return tuple(
            Parameter(self.id, self.whole, symbol + ending, unit + per, sd, -BOUND * sd, BOUND * sd, meaning=meaning)
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
        still = {"time": ca.SX(self.left)} if self.constant else {"time": ca.SX(1, 1), "temperature": ca.SX(self.left)}
        as_left = replace(row, **still)
        return point + self.change(grown - self.warmth(p, as_left), point)

    @abstractmethod
    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return a point's displacement (3,)."""


@dataclass(frozen=True)
class StandGrowth(DeviceGrowth):
    """Reported position + (x, y, z) g, and with turning + g r x position, where g grows with T or with 1 - exp(-t / constant).

    g is zero where the stand was left.
    """

    turning: bool = False

    id = "stand-growth"
    title = "growth of the device's stand or the robot's foot"
    words = Words(
        "growth of the device's stand or the robot's foot",
        "the device's stand, or the robot's foot, follows the temperature, or settles",
    )
    readable = {"m/K": (1e6, "µm per °C"), "rad/K": (1e6, "µrad per °C")}
    course = "settling"
    told_by = "measure points fixed to the floor from time to time"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature or with a grid of time constants, without and with rotation."""
        shifting = super().variants(robot, data)
        return (*shifting, *(replace(growth, turning=True) for growth in shifting))

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

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return a point's displacement (3,)."""
        return displaced(p, point)


@dataclass(frozen=True)
class ScaleGrowth(DeviceGrowth):
    """Reported position times 1 + s g, where g grows with T or with 1 - exp(-t / constant).

    g is zero where the device was left: a constant scale is indistinguishable from longer links, but not one that changes.
    """

    id = "scale-growth"
    title = "growth of the measuring device's scale"
    words = Words(
        "growth of the measuring device's scale",
        "the device's metre, or all that is measured with it, grows with the temperature",
        "relative change",
    )
    readable = {"1": (1e6, "µm/m")}
    told_by = "measure a known length from time to time, and check the device's weather station"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where no positions were measured."""
        return "" if data.has_positions else "measured positions"

    @property
    def changes(self) -> list[tuple[str, str, float, str]]:
        """That of the scale."""
        return [("s", "1", SCALE_SDS[0 if self.constant else 1], "growth of the scale")]

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return a point's displacement (3,)."""
        return p * point


@dataclass(frozen=True)
class LensGrowth(OfImages, DeviceGrowth):
    """Focal lengths times 1 + f g, the image's centre + (x, y) g focal lengths, where g grows with T or 1 - exp(-t / constant).

    g is zero where the camera was left.
    """

    id = "lens-growth"
    title = "growth of the camera's lens"
    words = Words(
        "growth of the camera's lens", "the lens or the sensor follows the temperature, or warms up", "relative change"
    )
    told_by = "let the camera warm up first, or photograph a target fixed beside it from time to time"

    @property
    def changes(self) -> list[tuple[str, str, float, str]]:
        """Those of the focal lengths, and of the image's centre."""
        return [
            (symbol, "1", LENS_SDS[0 if self.constant else 1], f"growth of the {meaning}") for symbol, meaning in LENS
        ]

    def warmth(self, p: ca.SX, row: Row) -> ca.SX:
        """Return the parameters times the growth of the same camera."""
        return super().warmth(p, row) * self.mine(row)

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return the displacement (3,) of a point in the camera's frame that changes its image alike."""
        return refocused(p, point)
