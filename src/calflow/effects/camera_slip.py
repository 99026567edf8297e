"""Slips: a camera or its target that shifted once on its mount, or whose bracket was knocked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from calflow.effects.base import Words, several_imaged
from calflow.effects.frame_step import FrameStep
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class CameraSlip(FrameStep):
    """Point in the camera's frame + (x, y, z) + r x point, from one image on."""

    turning: bool = True

    id = "camera-slip"
    title = "camera that slipped"
    shown_by = "images"
    words = Words("camera that slipped", "the camera moved once on what it is fixed to", "shift")
    told_by = "photograph a target fixed beside the camera from time to time, or some of the first poses again"
    shift_sd, turn_sd = 5e-4, 1e-3
    most: ClassVar[tuple[tuple[bool, int], ...]] = ((True, 40),)
    slipping: ClassVar[str] = "camera"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where the images are not of one camera (or target)."""
        return several_imaged(data, cls.slipping)

    @property
    def detail(self) -> str:
        """The row after which it slipped."""
        return f"after row {int(np.floor(self.moment))} in measuring order"

    @classmethod
    def spans(cls, data: Measurements) -> np.ndarray:
        """Return the first and last position of each image in measuring order, (n, 2)."""
        images = data.table.groupby(["pose", "repeat"])["order"].agg(["min", "max"])
        return images.sort_values("min").to_numpy(float)


@dataclass(frozen=True)
class TargetSlip(CameraSlip):
    """Point in the target's frame + (x, y, z) + r x point, from one image on."""

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
        """Return the point, shifted after the slip."""
        return super().device(p, point, row)
