"""Slips: a camera or its target that shifted once on its mount, or whose bracket was knocked, or a lens that was touched."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import OF_THE_FRAME, Words
from calflow.effects.displacement import LENS, MOTION
from calflow.effects.of_images import OfImages
from calflow.effects.step_change import PointStep
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class CameraSlip(OfImages, PointStep):
    """Point in the camera's frame - (x, y, z) - r x point, up to an image; of one camera, where there are several."""

    id = "camera-slip"
    title = "camera that slipped"
    words = Words("camera that slipped", "the camera moved once on what it is fixed to", "shift")
    whole = "device"
    family = OF_THE_FRAME
    told_by = "photograph a target fixed beside the camera from time to time, or some of the first poses again"
    displacement, sds = MOTION, {"m": 5e-4, "rad": 1e-3}

    def before(self, row: Row) -> ca.SX:
        """Return 1 for a row of the same camera (or target) before the slip, else 0."""
        return super().before(row) * self.mine(row)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the figures of what slipped."""
        return self.of_part(self.whole)

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
    displacement, sds = LENS, {"1": 2e-3}
