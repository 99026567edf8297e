"""Datum cube: touches of the faces of a block, square to each other, whose place nobody knows."""

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
from calflow.observations.base import Seen
from calflow.observations.touched import Surface
from calflow.robot.frames import angles, placement_matrix
from calflow.robot.parts import Parameter

FACES = ("x", "y", "z", "-x", "-y", "-z")
ROUGH = 5e-3  # m: what a nominal robot may err by


class DatumCubeSettings(FileModel):
    """size_mm along x, y and z, which the faces -x, -y and -z ask for.

    origin_mm and rotation_deg are roughly where the corner of the faces x, y and z will be, and how it is turned: for poses that
    are to be planned.
    """

    size: Lengths3 | None = None
    origin: Lengths3 | None = None
    rotation: Angles3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DatumCube(Surface):
    """Height of the marker over a face = reading (0 where none is reported); a cube each name in the column `cube`.

    Faces x, y and z meet in the corner that is the cube's origin, each looking along its axis; -x, -y and -z are the opposite ones,
    as far away as the cube is large. Settings: size (3,) [m], exact; origin (3,) [m] and rotation (3,) [rad], roughly,
    for poses that are to be planned.
    """

    id = "datum-cube"
    title = "points on the faces of a cube"
    columns = Reported({"face": ""}, {"reading": "length"}, ("face", "cube"))
    settings = DatumCubeSettings
    units = (METRE,)
    labelled_by = ("cube",)

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the cubes that the rows name.

        Raises:
            InputError: a face that no cube has, or one opposite another of a cube whose size is not stated.
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
        """Return a cube where the settings say."""
        origin = series.triple("origin")
        if origin is None:
            raise ValueError("state where the cube's corner will be, roughly: origin_mm = [x, y, z] and rotation_deg")
        return cls.at(series, (*origin, *(series.triple("rotation") or ())))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of each cube's place, in its own axes."""
        return tuple(self.place_errors())

    @property
    def reports(self) -> int:
        """A reading, the way that the face looks, how far it is from the corner, and which cube it is of."""
        return 5 + len(self.names)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings, the faces' normals and distances, and the cubes."""
        face = np.array([FACES.index(str(face)) for face in table["face"]], dtype=int)
        sign = np.where(face < 3, 1.0, -1.0)
        far = np.where(face < 3, 0.0, np.array(self.series.triple("size") or (0.0, 0.0, 0.0))[face % 3])
        return np.vstack([self.readings(table), sign * np.eye(3)[:, face % 3], far, *self.which(table)]).astype(float)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the height over the face less the reading."""
        at = self.frame(p, y[5:])
        return ca.dot(y[1:4], at[:3, :3].T @ (seen.point - at[:3, 3])) - y[4] - y[0]

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Lay each cube against the nominal robot's points."""
        reported = self.reported(table)
        return self.laid(table, lambda rows: _laid(points[rows], reported[:5, rows]))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the heights over the first cube's faces x, y and z in turn."""
        at = placement_matrix(self.nominal[0])
        face = np.arange(len(points)) % 3
        normal = np.eye(3)[:, face]
        height = (normal * (at[:3, :3].T @ (points - at[:3, 3]).T)).sum(axis=0)
        return np.vstack([height, normal, np.zeros(len(points)), self.first(len(points))])


def _laid(points: np.ndarray, reported: np.ndarray) -> tuple[float, ...] | None:
    """A cube's place (6,) from points (n, 3) on its faces; None where fewer than two of its axes are told.

    Each axis is told by the points of a face but for its sense: the senses are those that leave least.
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
            continue  # a mirrored one, and its own opposite is tried as well
        turn = Rotation.align_vectors(seen, np.eye(3)[sides])[0]
        ways = turn.apply(normal)
        corner = np.linalg.lstsq(ways, (ways * points).sum(axis=1) - far - reading, rcond=None)[0]

        def missed(x: np.ndarray, turn: Rotation = turn) -> np.ndarray:
            along = (turn * Rotation.from_rotvec(x[3:])).apply(normal)
            return np.asarray(((along * (points - x[:3])).sum(axis=1) - far - reading) / ROUGH)

        fit = scipy.optimize.least_squares(missed, [*corner, 0.0, 0.0, 0.0], loss="soft_l1")
        outwards = float((ways * -points).sum())  # towards the robot's base, from where a face is touched
        candidates.append((round(fit.cost, 6), -outwards, fit.x[:3], turn * Rotation.from_rotvec(fit.x[3:])))
    _, _, corner, turn = min(candidates, key=lambda candidate: candidate[:2])
    return (*corner, *angles(turn))
