"""Growth of the measuring device: a stand that moves, or a scale or a lens that changes, with the temperature or as it warms up."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca

from calflow.effects.base import OF_THE_FRAME, Words
from calflow.effects.displacement import LENS, SCALE, Displacement, Rigid
from calflow.effects.of_images import OfImages
from calflow.effects.warming import REFERENCE, Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

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
    warm: ClassVar[Mapping[str, float]]  # usual sizes by unit, once it is warm,
    by_kelvin: ClassVar[Mapping[str, float]]  # and per kelvin

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
    def displacement(self) -> Displacement:
        """What happens to the points that are reported."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the changes, and those at first where the device warms up again after pauses."""
        sds, per = (self.warm, "") if self.constant else (self.by_kelvin, "/K")
        what = {"m": "shift", "rad": "turn", "1": "growth"}
        return tuple(self.displacement.parameters(self, self.whole, sds, BOUND, what, per, self.symbols))

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
        return point + self.displacement.moved(grown - self.warmth(p, as_left), point)


@dataclass(frozen=True)
class StandGrowth(Rigid, DeviceGrowth):
    """Reported position + (x, y, z) g, and with turning + g r x position, where g grows with T or with 1 - exp(-t / constant).

    g is zero where the stand was left.
    """

    id = "stand-growth"
    title = "growth of the device's stand or the robot's foot"
    words = Words(
        "growth of the device's stand or the robot's foot",
        "the device's stand, or the robot's foot, follows the temperature, or settles",
    )
    readable = {"m/K": (1e6, "µm per °C"), "rad/K": (1e6, "µrad per °C")}
    course = "settling"
    told_by = "measure points fixed to the floor from time to time"
    warm, by_kelvin = {"m": 3e-4, "rad": 1e-4}, {"m": 2e-5, "rad": 1e-5}  # of a stand of steel, 2 m high

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth with the temperature or with a grid of time constants, without and with rotation."""
        shifting = super().variants(robot, data)
        return (*shifting, *(replace(growth, turning=True) for growth in shifting))


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
    displacement = SCALE
    warm, by_kelvin = {"1": 5e-5}, {"1": 1e-5}  # of steel, ten times as much as of a beam in air

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where no positions were measured."""
        return "" if data.has_positions else "measured positions"


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
    displacement = LENS
    warm, by_kelvin = {"1": 1e-3}, {"1": 5e-5}  # of the focal length, a pixel or two at the edge of an image

    def warmth(self, p: ca.SX, row: Row) -> ca.SX:
        """Return the parameters times the growth of the same camera."""
        return super().warmth(p, row) * self.mine(row)
