"""Sphere: a probe's tip on a ball, whose centre nobody knows, nor its radius where that is not stated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
import scipy
from pydantic import Field

from calflow.files.deferred import pd
from calflow.files.toml import FileModel, Length, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Seen
from calflow.observations.touched import Surface
from calflow.robot.parts import Parameter

USUAL_RADIUS, RADIUS_SD = 0.025, 0.1  # m: of a ball that nobody measured
FURTHEST = 20.0  # standard deviations of a radius that is known
ROUGH = 5e-3  # m: what a nominal robot may err by, where the centre is looked for


class SphereSettings(FileModel):
    """radius_mm from a sphere's centre to the marker, with a probe's tip, and radius_sd_mm, how surely it is known (0: exactly).

    Where it is not stated it is found. centre_mm is roughly where the sphere will be: for poses that are to be planned.
    """

    radius: Length | None = Field(default=None, gt=0)
    radius_sd: Length = Field(default=0.0, ge=0)
    centre: Lengths3 | None = None


@dataclass(frozen=True)
class Sphere(Surface):
    """|marker - centre| - radius = reading (0 where none is reported); a sphere each name in the column `sphere`.

    All spheres of a series have one radius. Settings: radius [m] and radius_sd [m] (0: known exactly), centre (3,) [m],
    roughly, for poses that are to be planned.
    """

    found: float | None = None  # m: the radius by the rows, where nobody states it

    id = "sphere"
    title = "points on a sphere"
    columns = Reported({}, {"reading": "length"}, ("sphere",))
    settings = SphereSettings
    units = (METRE,)
    labelled_by = ("sphere",)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a sphere where the settings say."""
        centre = series.triple("centre")
        if centre is None:
            raise ValueError("state where the sphere will be, roughly: centre_mm = [x, y, z], and its radius_mm")
        return cls.at(series, centre)

    @property
    def radius(self) -> float:
        """What the radius' error refers to [m]."""
        return self.series.number("radius") or self.found or USUAL_RADIUS

    @property
    def _radius_sd(self) -> float:
        """How surely the radius is known [m]; 0: exactly."""
        return RADIUS_SD if self.series.number("radius") is None else self.series.number("radius_sd") or 0.0

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each centre, then what the radius errs by, as far as it is not known."""
        parameters = self.place_errors("xyz")
        if sd := self._radius_sd:
            low = max(-FURTHEST * sd, -0.9 * self.radius)
            parameters.append(Parameter(self.id, self.part, "radius", "m", sd, low, FURTHEST * sd, figure=self.radius,
                                   meaning=f"radius of {self.part}"))  # fmt: skip
        return tuple(parameters)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the distance from the sphere less the reading."""
        n = len(self.names)
        centre = (ca.DM(np.array(self.nominal)[:, :3].T) + ca.reshape(p[: 3 * n], 3, n)) @ y[1:]
        radius = self.radius + (p[3 * n] if self._radius_sd else 0.0)
        return ca.norm_2(seen.point - centre) - radius - y[0]

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Lay each sphere through the nominal robot's points; where nobody knows the radius it is the mean of what they say."""
        stated, reading, radii = self.series.number("radius"), self.readings(table), list[float]()

        def found(rows: np.ndarray) -> np.ndarray:
            centre, radius = _laid(points[rows], reading[rows], stated)
            radii.append(radius)
            return centre

        laid = self.laid(table, found, 4)
        return laid if stated or self.found or not radii else replace(laid, found=float(np.mean(radii)))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the distances from the first sphere."""
        distance = np.linalg.norm(points - np.array(self.nominal[0][:3]), axis=1)
        return np.vstack([distance - self.radius, self.first(len(points))])


def _laid(points: np.ndarray, reading: np.ndarray, stated: float | None) -> tuple[np.ndarray, float]:
    """A sphere's centre (3,) and radius [m] from points (n, 3) at distances (n,) from it."""
    # |point|² - 2 point·centre + |centre|² = radius²: linear but for one unknown.
    system = np.column_stack([2 * points, np.ones(len(points))])
    *centre, rest = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    radius = stated or float(np.sqrt(max(rest + np.dot(centre, centre), 0.0))) or USUAL_RADIUS

    def missed(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - x[:3], axis=1) - reading
        return np.append((distance - x[3]) / ROUGH, 0.0 if stated is None else (x[3] - stated) / (1e-6 * stated))

    fitted = scipy.optimize.least_squares(missed, [*centre, radius], loss="soft_l1").x
    return fitted[:3], float(fitted[3])
