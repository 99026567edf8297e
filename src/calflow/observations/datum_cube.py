"""Datum cube: touches of the mutually perpendicular faces of a block whose pose is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Self

import casadi as ca
import numpy as np
import scipy

from calflow.files.deferred import Rotation, pd
from calflow.files.problems import refuse
from calflow.files.toml import Angles3, FileModel, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Links, Seen
from calflow.observations.touched import Surface
from calflow.robot.frames import angles, placement_matrix
from calflow.robot.parts import Parameter

FACES = ("x", "y", "z", "-x", "-y", "-z")
ROUGH = 5e-3  # m: typical error of a nominal robot


class DatumCubeSettings(FileModel):
    """size_mm along x, y and z, required for rows on the faces -x, -y and -z.

    origin_mm and rotation_deg state the approximate pose of the corner of the faces x, y and z, for planning poses.
    """

    size: Lengths3 | None = None
    origin: Lengths3 | None = None
    rotation: Angles3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DatumCube(Surface):
    """Height of the marker over a face = reading (0 where none is reported); one cube per name in the column `cube`.

    Faces x, y and z meet in the corner that is the cube's origin, with outward normals along their axes; -x, -y and -z are the
    opposite faces, at the distance given by the size. Settings: size (3,) [m], exact; origin (3,) [m] and rotation (3,)
    [rad], approximate, for planning poses.
    """

    id = "datum-cube"
    title = "points on the faces of a cube"
    columns = Reported({"face": ""}, {"reading": "length"}, ("face", "cube"))
    settings = DatumCubeSettings
    units = (METRE,)
    labelled_by = ("cube",)
    of_row = 5  # the reading, the face's normal, and its distance from the corner

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the cubes that the rows name.

        Raises:
            InputError: an unknown face, or an opposite face (-x, -y, -z) of a cube whose size is not stated.
        """
        faces = dict.fromkeys(map(str, table["face"]))
        if strange := [face for face in faces if face not in FACES]:
            raise refuse(f"face {', '.join(map(repr, strange))}: expected {', '.join(FACES)}", key="measurements.face")
        if series.triple("size") is None and any(face.startswith("-") for face in faces):
            raise refuse(
                "faces -x, -y, -z are opposite x, y, z: state the cube's size_mm = [x, y, z]",
                key="measurements.settings.size_mm",
            )
        return super().of(series, table)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a cube at the pose stated in the settings."""
        origin = series.triple("origin")
        if origin is None:
            raise ValueError("state where the cube's corner will be, roughly: origin_mm = [x, y, z] and rotation_deg")
        return cls.at(series, (*origin, *(series.triple("rotation") or ())))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of each cube's pose, in its own axes."""
        return tuple(self.place_errors())

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings, the faces' normals and distances, and the one-hot cubes."""
        face = np.array([FACES.index(str(face)) for face in table["face"]], dtype=int)
        sign = np.where(face < 3, 1.0, -1.0)
        far = np.where(face < 3, 0.0, np.array(self.series.triple("size") or (0.0, 0.0, 0.0))[face % 3])
        return np.vstack([self.readings(table), sign * np.eye(3)[:, face % 3], far, *self.which(table)]).astype(float)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the height over the face minus the reading."""
        at = self.frame(p, y[5:])
        return ca.dot(y[1:4], at[:3, :3].T @ (seen.device(seen.point) - at[:3, 3])) - y[4] - y[0]

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each cube registered to the nominal robot's points."""
        reported = self.reported(table)
        return self.laid(table, lambda rows: _fitted_cube(points[rows], reported[:5, rows]))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the heights over the first cube's faces x, y and z in turn."""
        at = placement_matrix(self.nominal[0])
        face = np.arange(len(points)) % 3
        normal = np.eye(3)[:, face]
        height = (normal * (at[:3, :3].T @ (points - at[:3, 3]).T)).sum(axis=0)
        return np.vstack([height, normal, np.zeros(len(points)), self.first(len(points))])


def _fitted_cube(points: np.ndarray, reported: np.ndarray) -> tuple[float, ...] | None:
    """Return a cube's pose (6,) from points (n, 3) on its faces; None where they determine fewer than two of its axes.

    The points of a face determine its axis up to sign; of all combinations of signs the one of least residual is returned.
    """
    reading, normal, far = reported[0], reported[1:4].T, reported[4]
    axes: dict[int, np.ndarray] = {}
    for sign, k in product((1.0, -1.0), range(3)):
        touched = points[normal[:, k] == sign]
        if len(touched) >= 3 and k not in axes:
            axes[k] = np.linalg.svd(touched - touched.mean(axis=0))[2][2]
    if len(axes) < 2:
        return None
    sides = sorted(axes)
    candidates = []
    for senses in product((1.0, -1.0), repeat=len(sides)):
        seen = np.array([sense * axes[k] for sense, k in zip(senses, sides, strict=True)])
        if len(sides) == 3 and np.linalg.det(seen) < 0:
            continue  # left-handed; the opposite signs are tried too
        turn = Rotation.align_vectors(seen, np.eye(3)[sides])[0]
        ways = turn.apply(normal)
        corner = np.linalg.lstsq(ways, (ways * points).sum(axis=1) - far - reading, rcond=None)[0]

        def residuals(x: np.ndarray, turn: Rotation = turn) -> np.ndarray:
            along = (turn * Rotation.from_rotvec(x[3:])).apply(normal)
            return np.asarray(((along * (points - x[:3])).sum(axis=1) - far - reading) / ROUGH)

        fit = scipy.optimize.least_squares(residuals, [*corner, 0.0, 0.0, 0.0], loss="soft_l1")
        outwards = float((ways * -points).sum())  # towards the robot's base, from where a face is touched
        candidates.append((round(fit.cost, 6), -outwards, fit.x[:3], turn * Rotation.from_rotvec(fit.x[3:])))
    _, _, corner, turn = min(candidates, key=lambda candidate: candidate[:2])
    return (*corner, *angles(turn))
