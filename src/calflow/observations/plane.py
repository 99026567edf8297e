"""Plane: points on a plane of unknown pose, or a dial gauge's readings above it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np
from pydantic import field_validator

from calflow.files.deferred import Rotation, pd
from calflow.files.toml import FileModel, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Links, Seen
from calflow.observations.touched import Surface
from calflow.robot.frames import angles
from calflow.robot.parts import Parameter

LAID = 20  # iterations of foot points, normal and weights, which converge fast: heights are small against the plane
NEAR = 1e-4  # m: points closer to the plane than this have equal weights


class PlaneSettings(FileModel):
    """Approximate pose of the plane, for planning poses: a point_mm on it, and its normal."""

    point: Lengths3 | None = None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @field_validator("normal")
    @classmethod
    def _points_somewhere(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        if not np.linalg.norm(normal) > 0:
            raise ValueError("expected a direction other than [0, 0, 0]")
        return normal


@dataclass(frozen=True)
class Plane(Surface):
    """Height of the marker over a plane = reading (0 where none is reported); one plane per name in the column `plane`.

    A plane's normal is the z axis of its frame: towards the side from which the readings count, or the robot's base without any.
    Settings: point (3,) [m] and normal (3,), approximate, for planning poses.
    """

    id = "plane"
    title = "points on a plane"
    columns = Reported({}, {"reading": "length"}, ("plane",))
    settings = PlaneSettings
    units = (METRE,)
    labelled_by = ("plane",)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a plane at the pose stated in the settings."""
        point, normal = series.triple("point"), series.triple("normal") or (0.0, 0.0, 1.0)
        if point is None:
            raise ValueError("state where the plane will be, roughly: point_mm = [x, y, z] on it, and its normal")
        turn = Rotation.align_vectors(np.array([normal], dtype=float), np.array([[0.0, 0.0, 1.0]]))[0]
        return cls.at(series, (*point, *angles(turn)))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of height and of two tilts per plane."""
        return tuple(self.place_errors(("z", "rx", "ry")))

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the height over the plane minus the reading."""
        which = y[1:]
        values, none = ca.reshape(p, 3, len(self.names)), ca.SX(1, len(self.names))
        tilted = self.frame(ca.vec(ca.vertcat(none, none, values, none)), which)
        return ca.dot(tilted[:3, 2], seen.device(seen.point) - tilted[:3, 3]) - y[0]

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each plane fitted to the nominal robot's points."""
        reading = self.readings(table)

        def found(rows: np.ndarray) -> tuple[float, ...]:
            foot, normal = _fitted_plane(points[rows], reading[rows])
            turn = Rotation.align_vectors(normal[None], np.array([[0.0, 0.0, 1.0]]))[0]
            return (*foot, *angles(turn))

        return self.laid(table, found, 3)

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the heights over the first plane."""
        turn = Rotation.from_euler("XYZ", self.nominal[0][3:])
        height = (points - np.array(self.nominal[0][:3])) @ turn.as_matrix()[:, 2]
        return np.vstack([height, self.first(len(points))])


def _fitted_plane(points: np.ndarray, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a plane's centre and its normal, from points (n, 3) at heights (n,) over it.

    The normal is towards the side on which the readings agree with the points; the base's, where that makes no difference.
    """
    (centre, normal, error), (other_centre, other, other_error) = (
        _laid(points, side * reading) for side in (1.0, -1.0)
    )
    return (centre, normal) if error <= other_error else (other_centre, -other)


def _laid(points: np.ndarray, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return a plane's centre, its normal towards the base, and the mean error of heights (n,), whose least the plane has.

    Least absolute deviations, by reweighted least squares: a point of another plane moves it little.
    """
    feet, weight = points, np.ones(len(points))
    for _ in range(LAID):
        centre = np.average(feet, axis=0, weights=weight)
        normal = np.linalg.svd(np.sqrt(weight)[:, None] * (feet - centre))[2][2]
        normal = normal if normal @ centre <= 0 else -normal
        error = np.abs((points - centre) @ normal - reading)
        feet, weight = points - reading[:, None] * normal, 1 / np.maximum(error, NEAR)
    return np.average(feet, axis=0, weights=weight), normal, float(error.mean())
