"""Plane: points on a surface of unknown place, or a dial gauge's reading above it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
import pandas as pd
from pydantic import field_validator
from scipy.spatial.transform import Rotation

from calflow.files.toml import FileModel, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import UNKNOWN_BOUND, UNKNOWN_SD, Observation, Placement, Seen
from calflow.robot.frames import angles, placement
from calflow.robot.parts import Parameter

NOWHERE = (0.0,) * 6
LAID = 10  # turns in which feet and normal settle: heights of millimetres tilt a plane of a metre by little


class PlaneSettings(FileModel):
    """Roughly where the plane will be, for poses that are to be planned: a point_mm on it, and its normal."""

    point: Lengths3 | None = None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @field_validator("normal")
    @classmethod
    def _points_somewhere(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        if not np.linalg.norm(normal) > 0:
            raise ValueError("expected a direction other than [0, 0, 0]")
        return normal


@dataclass(frozen=True)
class Plane(Observation):
    """Height of the marker over a plane = reading (0 where none is reported); a plane each name in the column `plane`.

    A plane's normal is the z axis of its frame, to the side that the robot's base is on. nominal holds origin and angles.
    Settings: point (3,) [m] and normal (3,), roughly, for poses that are to be planned.
    """

    planes: tuple[str, ...] = ("",)
    nominal: tuple[tuple[float, ...], ...] = (NOWHERE,)

    id = "plane"
    title = "points on a plane"
    columns = Reported({}, {"reading": "length"}, ("plane",))
    settings = PlaneSettings
    units = (METRE,)
    touches = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the planes that the rows name."""
        planes = tuple(dict.fromkeys(_names(table)))
        return cls(series, planes, (NOWHERE,) * len(planes))

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a plane where the settings say."""
        point, normal = series.triple("point"), series.triple("normal") or (0.0, 0.0, 1.0)
        if point is None:
            raise ValueError("state where the plane will be, roughly: point_mm = [x, y, z] on it, and its normal")
        turn = Rotation.align_vectors(np.array([normal], dtype=float), np.array([[0.0, 0.0, 1.0]]))[0]
        return cls(series, ("",), ((*point, *map(float, angles(turn))),))

    def _part(self, plane: str) -> str:
        return f"{self.part}-{plane}" if plane else self.part

    def parameters(self) -> tuple[Parameter, ...]:
        """Return a height and two tilts a plane."""
        return tuple(
            Parameter(self.id, self._part(plane), symbol, unit, UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND,
                      meaning=f"{words} of {self._part(plane)}")
            for plane in self.planes
            for symbol, unit, words in (("z", "m", "height"), ("rx", "rad", "tilt about x"), ("ry", "rad", "tilt about y"))
        )  # fmt: skip

    @property
    def reports(self) -> int:
        """A reading, and which plane it is over."""
        return 1 + len(self.planes)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings and the planes."""
        reading = table["reading"].to_numpy(float) if "reading" in table else np.zeros(len(table))
        names = np.array(_names(table), dtype=object)
        return np.vstack([reading, *(names == plane for plane in self.planes)]).astype(float)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the height over the plane less the reading."""
        which = y[1:]
        own = ca.reshape(p, 3, len(self.planes)) @ which
        stands = placement(ca.DM(np.array(self.nominal)).T @ which)
        tilted = stands @ placement(ca.vertcat(0, 0, own[0], own[1], own[2], 0))
        return ca.dot(tilted[:3, 2], seen.point - tilted[:3, 3]) - y[0]

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Lay each plane through the nominal robot's points."""
        reported = self.reported(table)
        found = []
        for own, before in zip(reported[1:].astype(bool), self.nominal, strict=True):
            if own.sum() < 3:
                found.append(before)
                continue
            foot, normal = _laid(points[own], reported[0, own])
            turn = Rotation.align_vectors(normal[None], np.array([[0.0, 0.0, 1.0]]))[0]
            found.append((*map(float, foot), *map(float, angles(turn))))
        return replace(self, nominal=tuple(found))

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The planes' frames."""
        return tuple(
            Placement(self._part(plane), tuple(at[:3]), tuple(at[3:]))  # type: ignore[arg-type]
            for plane, at in zip(self.planes, self.nominal, strict=True)
        )

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return it with the planes of an earlier one."""
        known = [placements[self._part(plane)] for plane in self.planes]
        return replace(self, nominal=tuple((*one.origin, *one.rotation) for one in known))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the heights over the first plane."""
        turn = Rotation.from_euler("XYZ", self.nominal[0][3:])
        height = (points - np.array(self.nominal[0][:3])) @ turn.as_matrix()[:, 2]
        which = np.zeros((len(self.planes), len(points)))
        which[0] = 1.0
        return np.vstack([height, which])

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return readings of nothing: on the plane itself."""
        found = self.expected(points, rotations)
        found[0] = 0.0
        return found

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a plane is new."""
        return not set(_names(table)) <= set(self.planes)

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new planes."""
        new = tuple(name for name in dict.fromkeys(_names(table)) if name not in self.planes)
        return replace(self, planes=self.planes + new, nominal=self.nominal + (NOWHERE,) * len(new))


def _laid(points: np.ndarray, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A plane's middle and its normal towards the base, from points (n, 3) at heights (n,) over it."""
    feet = points
    for _ in range(LAID):
        centre = feet.mean(axis=0)
        normal = np.linalg.svd(feet - centre)[2][2]
        normal = normal if normal @ centre <= 0 else -normal
        feet = points - reading[:, None] * normal
    return feet.mean(axis=0), normal


def _names(table: pd.DataFrame) -> list[str]:
    return [str(name) for name in table["plane"]] if "plane" in table else [""] * len(table)
