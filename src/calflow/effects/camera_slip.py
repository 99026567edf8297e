"""Slips: a camera or its target that shifted once on its mount, or whose bracket was knocked, or a lens that was touched."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import LENS, OF_THE_FRAME, Words, refocused, several_imaged
from calflow.effects.step_change import BOUND, StepChange
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, name_number
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class CameraSlip(StepChange):
    """Point in the camera's frame - (x, y, z) - r x point, up to an image; of one camera, where there are several."""

    of: str = ""

    id = "camera-slip"
    title = "camera that slipped"
    imaged = True
    words = Words("camera that slipped", "the camera moved once on what it is fixed to", "shift")
    whole = "device"
    family = OF_THE_FRAME
    told_by = "photograph a target fixed beside the camera from time to time, or some of the first poses again"
    shift_sd, turn_sd = 5e-4, 1e-3
    slipping: ClassVar[str] = "camera"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where no column tells several cameras (or targets) apart."""
        return "" if f"{cls.slipping}_number" in data.given else several_imaged(data, cls.slipping)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each form between images, of each camera (or target) between its own."""
        if f"{cls.slipping}_number" not in data.given:
            return super().variants(robot, data)
        found: list[Self] = []
        names = data.imaged(cls.slipping)
        for name in dict.fromkeys(names):
            found += [replace(each, of=name) for each in super().variants(robot, data.only(names == name))]
        return tuple(found)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one between images of the same camera (or target)."""
        return super().finer(data.only(self._shown(data)))

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows of which the fitted ones do not tell whether they are before the slip."""
        about = self._shown(data)
        about[about] = super().undecided(data.only(about))
        return about

    def same_as(self, other: Self) -> bool:
        """Whether both are of one camera (or target), at moments too close for two separate slips."""
        return self.of == other.of and super().same_as(other)

    @property
    def detail(self) -> str:
        """The image after which it slipped, and which of several it was."""
        return super().detail + f", {self.slipping} {self.of}" * bool(self.of)

    def before(self, row: Row) -> ca.SX:
        """Return 1 for a row of the same camera (or target) before the slip, else 0."""
        before = super().before(row)
        number = getattr(row, f"{self.slipping}_number")
        return before * (number == name_number(self.of)) if self.of and before.nnz() else before

    def _shown(self, data: Measurements) -> np.ndarray:
        """Return the mask of the rows of its camera (or target), (n_rows,)."""
        return data.imaged(self.slipping) == self.of if self.of else np.ones(len(data), dtype=bool)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift and the rotation."""
        return self.along_axes(self.whole, turning=True)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, as it was seen before the slip."""
        return self.undone(p, point, row)


@dataclass(frozen=True)
class TargetSlip(CameraSlip):
    """Point in the target's frame - (x, y, z) - r x point, up to an image."""

    id = "target-slip"
    title = "target that slipped"
    words = Words("target that slipped", "the board moved once on what it is fixed to", "shift")
    whole = "target"
    told_by = "clamp the board, and photograph it at some of the first poses again"
    slipping = "target"

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point unchanged: the camera did not slip."""
        return point

    def target(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, as it was before the slip."""
        return self.undone(p, point, row)


@dataclass(frozen=True)
class LensStep(CameraSlip):
    """Focal lengths times 1 - f, the image's centre - (x, y) focal lengths, up to an image."""

    id = "lens-step"
    title = "lens that was touched"
    words = Words(
        "lens that was touched", "focus, zoom or the lens in its mount moved once", "relative change of its images"
    )
    told_by = "lock focus and zoom, and photograph some of the first poses again"
    lens_sd: ClassVar[float] = 2e-3

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the change of the focal lengths, and the shift of the image's centre."""
        sd = self.lens_sd
        return tuple(
            Parameter(self.id, self.whole, symbol, "1", sd, -BOUND * sd, BOUND * sd, meaning=f"step of the {meaning}")
            for symbol, meaning in LENS
        )

    def change(self, p: ca.SX, point: ca.SX) -> ca.SX:
        """Return the displacement (3,) of a point in the camera's frame that changes its image alike."""
        return refocused(p, point)
