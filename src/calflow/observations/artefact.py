"""Artefact: the tool at points with known coordinates on a plate or ladder whose pose is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import casadi as ca
import numpy as np
from pydantic import Field

from calflow.files.deferred import pd
from calflow.files.toml import Angles3, FileModel, Lengths3, Unit
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import FURTHEST, Links, Seen
from calflow.observations.touched import Touched
from calflow.robot.frames import motion_onto, placement_matrix
from calflow.robot.parts import Parameter

POINT = ("px_x", "px_y", "px_z")


class ArtefactSettings(FileModel):
    """scale_sd_um_per_m: standard deviation of the artefact's scale (0: known exactly).

    origin_mm, rotation_deg and size_mm state its approximate pose and its size along x and y, for planning poses.
    """

    scale_sd: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)
    origin: Lengths3 | None = None
    rotation: Angles3 = (0.0, 0.0, 0.0)
    size: Annotated[tuple[float, float], Unit("length")] | None = None


@dataclass(frozen=True)
class Artefact(Touched):
    """The marker is at a known point of an artefact: marker = A (1 + scale) point, with a pose A for each `placement`.

    A row's point is in the artefact's frame. Settings: scale_sd (0: known exactly); origin (3,) [m], rotation (3,) [rad] and
    size (2,) [m], approximate, for planning poses.
    """

    id = "artefact"
    title = "known points of a plate or a ladder"
    columns = Reported({}, {}, ("placement",), within=dict.fromkeys(POINT, "length"), notes=("point",))
    settings = ArtefactSettings
    units = (METRE,) * 3
    size_setting = "scale_sd"
    labelled_by = ("placement",)
    of_row = 3  # the point

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return an artefact at the pose stated in the settings."""
        origin, size = series.triple("origin"), series.setting("size")
        if origin is None or size is None:
            raise ValueError(
                "state where the artefact will lie, roughly, and how large it is: origin_mm, rotation_deg, size_mm"
            )
        return cls.at(series, (*origin, *(series.triple("rotation") or ())))

    @property
    def _scale_sd(self) -> float:
        return self.series.number(self.size_setting) or 0.0

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the pose errors of each placement, in its own axes, then the scale error unless the scale is exact."""
        parameters = self.place_errors()
        if sd := self._scale_sd:
            parameters.append(Parameter(self.id, self.part, "scale", "1", sd, -FURTHEST * sd, FURTHEST * sd,
                                   meaning=f"scale of {self.part}", of_size=True))  # fmt: skip
        return tuple(parameters)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the points and the one-hot placements."""
        return np.vstack([table[list(POINT)].to_numpy(float).T, *self.which(table)]).astype(float)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the marker's position minus that of the artefact's point."""
        n = len(self.names)
        at = self.frame(p[: 6 * n], y[3:])
        scale = 1 + (p[6 * n] if self._scale_sd else 0.0)
        return seen.device(seen.point) - (at[:3, 3] + at[:3, :3] @ (scale * y[:3]))

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each artefact registered to the nominal robot's points."""
        plate_points = table[list(POINT)].to_numpy(float)
        return self.laid(table, lambda rows: motion_onto(plate_points[rows], points[rows]))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the first artefact's corners in turn, or these points in its frame where its size is not stated."""
        at, size = placement_matrix(self.nominal[0]), self.series.setting("size")
        local = (points - at[:3, 3]) @ at[:3, :3]
        if isinstance(size, tuple):
            corners = np.array([(0.0, 0.0, 0.0), (size[0], 0.0, 0.0), (*size[:2], 0.0), (0.0, size[1], 0.0)])
            local = corners[np.arange(len(points)) % len(corners)]
        return np.vstack([local.T, self.first(len(points))])
