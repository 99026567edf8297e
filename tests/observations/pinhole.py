"""A fixed camera with a known lens: what another package would bring, in one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import casadi as ca
import numpy as np
import pandas as pd
from pydantic import Field
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calflow.files.toml import Angles3, FileModel, Lengths3, Unit
from calflow.files.units import PIXEL, MeasurementUnit
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Links, Observation, Seen, Six
from calflow.robot.frames import placement
from calflow.robot.parts import UNKNOWN_BOUND, UNKNOWN_SD, Parameter

Image = Annotated[float, Unit("image")]
NOWHERE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SYMBOLS = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}


class PinholeSettings(FileModel):
    """The lens: focal length and the image's middle. Origin and rotation, roughly, are for poses that are to be planned."""

    focal: Image = Field(gt=0)
    middle: Annotated[tuple[float, float], Unit("image")]
    origin: Lengths3 | None = None
    rotation: Angles3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pinhole(Observation):
    """(u, v) = middle + focal · (x, y) / z of the marker in the camera's frame, which looks along its z axis."""

    place: Six = NOWHERE

    id: ClassVar[str] = "pinhole"
    title: ClassVar[str] = "a marker's image"
    columns: ClassVar[Reported] = Reported({"u": "image", "v": "image"})
    settings: ClassVar[type[FileModel]] = PinholeSettings
    units: ClassVar[tuple[MeasurementUnit, ...]] = (PIXEL, PIXEL)

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation, its camera not placed yet."""
        return cls(series)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return it with the camera where the settings say."""
        origin = series.triple("origin")
        if origin is None:
            raise ValueError("state where the camera will be, roughly: origin_mm and rotation_deg")
        return cls(series, (*origin, *(series.triple("rotation") or NOWHERE[3:])))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of the camera's place, in its own axes."""
        return tuple(
            Parameter(
                self.id,
                self.part,
                symbol,
                unit,
                UNKNOWN_SD,
                -UNKNOWN_BOUND,
                UNKNOWN_BOUND,
                meaning=f"{symbol} of the camera",
            )
            for symbol, unit in SYMBOLS.items()
        )

    @property
    def reports(self) -> int:
        """Two coordinates."""
        return 2

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the coordinates."""
        return table[["u", "v"]].to_numpy(float).T

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the difference of the images."""
        camera = placement(ca.DM(self.place)) @ placement(p)
        point = camera[:3, :3].T @ (seen.point - camera[:3, 3])
        focal, middle = self._lens
        return ca.DM(middle) + focal * point[:2] / point[2] - y

    @property
    def _lens(self) -> tuple[float, np.ndarray]:
        return self.series.number("focal") or 1.0, np.array(self.series.setting("middle"))

    def _image(self, points: np.ndarray, place: np.ndarray) -> np.ndarray:
        focal, middle = self._lens
        own = Rotation.from_euler("XYZ", place[3:]).inv().apply(points - place[:3])
        return middle + focal * own[:, :2] / own[:, 2:]

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Place the camera by the images of the nominal robot's points: by lines first, then by what the images are off."""
        focal, middle = self._lens
        seen = self.reported(table).T
        rays = np.column_stack([(seen - middle) / focal, np.ones(len(seen))])
        known, none = np.column_stack([points, np.ones(len(points))]), np.zeros((len(points), 4))
        lines = np.vstack(
            [np.hstack([known, none, -rays[:, :1] * known]), np.hstack([none, known, -rays[:, 1:2] * known])]
        )
        found = np.linalg.svd(lines)[2][-1].reshape(3, 4)
        found *= np.sign(np.linalg.det(found[:, :3])) / np.cbrt(abs(np.linalg.det(found[:, :3])))
        left, _, right = np.linalg.svd(found[:, :3])
        turn = Rotation.from_matrix((left @ right).T)
        begin = np.append(-turn.apply(found[:, 3]), turn.as_euler("XYZ"))
        settled = least_squares(lambda place: (self._image(points, place) - seen).ravel(), begin, loss="soft_l1").x
        return replace(self, place=tuple(map(float, settled)))

    @property
    def placements(self) -> dict[str, Six]:
        """The camera."""
        return {self.part: self.place}

    def placed(self, placements: Mapping[str, Six]) -> Self:
        """Return it with the camera of an earlier one."""
        return replace(self, place=placements[self.part])

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the images."""
        return self._image(points, np.array(self.place)).T
