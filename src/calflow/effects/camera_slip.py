"""Camera slip: a camera that moved once on what it is fixed to, or whose bracket was knocked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calflow.effects.base import Words
from calflow.effects.frame_step import FrameStep
from calflow.measurements.measurements import Measurements


@dataclass(frozen=True)
class CameraSlip(FrameStep):
    """Point in the camera's frame + (x, y, z) + r x point, from an image on."""

    turning: bool = True

    id = "camera-slip"
    title = "camera that slipped"
    words = Words("camera that slipped", "the camera moved once on what it is fixed to", "shift")
    told_by = "photograph a target fixed beside the camera from time to time, or some of the first poses again"
    shift_sd, turn_sd = 5e-4, 1e-3
    most: ClassVar[tuple[tuple[bool, int], ...]] = ((True, 40),)

    @classmethod
    def unfit(cls, data: Measurements) -> str:
        """Say that there are no images, or that nothing tells which camera slipped."""
        if not data.in_images:
            return "images of a target"
        alone = len(data.series) == 1 and ("camera" not in data.table or data.table["camera"].nunique() == 1)
        return "" if alone else "images of one camera alone"

    @property
    def detail(self) -> str:
        """Say when."""
        return f"after row {int(np.floor(self.moment))} in measuring order"

    @classmethod
    def spans(cls, data: Measurements) -> np.ndarray:
        """Return the first and the last place of each image in measuring order, (n, 2)."""
        images = data.table.groupby(["pose", "repeat"])["order"].agg(["min", "max"])
        return images.sort_values("min").to_numpy(float)
