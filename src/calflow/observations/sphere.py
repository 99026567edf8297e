"""Sphere: a probe's tip on a ball of unknown centre, and of unknown radius where it is not stated."""

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
from calflow.observations.base import FURTHEST, Links, Seen
from calflow.observations.touched import Surface
from calflow.robot.parts import Parameter

USUAL_RADIUS, RADIUS_SD = 0.025, 0.1  # m: of a ball of unknown radius
ROUGH = 5e-3  # m: typical error of a nominal robot, when the centre is located


class SphereSettings(FileModel):
    """radius_mm from a sphere's centre to the marker, including a probe's tip, and radius_sd_mm, its standard deviation (0: exact).

    Without radius_mm it is estimated. centre_mm is the approximate position of the sphere, for planning poses.
    """

    radius: Length | None = Field(default=None, gt=0)
    radius_sd: Length = Field(default=0.0, ge=0)
    centre: Lengths3 | None = None


@dataclass(frozen=True)
class Sphere(Surface):
    """|marker - centre| - radius = reading (0 where none is reported); one sphere per name in the column `sphere`.

    All spheres of a series have the same radius. Settings: radius [m] and radius_sd [m] (0: known exactly), centre (3,) [m],
    approximate, for planning poses.
    """

    found: float | None = None  # m: the radius estimated at registration, where it is not stated

    id = "sphere"
    title = "points on a sphere"
    columns = Reported({}, {"reading": "length"}, ("sphere",))
    settings = SphereSettings
    units = (METRE,)
    labelled_by = ("sphere",)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a sphere at the position stated in the settings."""
        centre = series.triple("centre")
        if centre is None:
            raise ValueError("state where the sphere will be, roughly: centre_mm = [x, y, z], and its radius_mm")
        return cls.at(series, centre)

    @property
    def radius(self) -> float:
        """Nominal radius [m]."""
        return self.series.number("radius") or self.found or USUAL_RADIUS

    @property
    def _radius_sd(self) -> float:
        """Prior standard deviation of the radius [m]; 0: known exactly."""
        return RADIUS_SD if self.series.number("radius") is None else self.series.number("radius_sd") or 0.0

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of each centre, then that of the radius unless it is exact."""
        parameters = self.place_errors("xyz")
        if sd := self._radius_sd:
            low = max(-FURTHEST * sd, -0.9 * self.radius)
            parameters.append(Parameter(self.id, self.part, "radius", "m", sd, low, FURTHEST * sd, figure=self.radius,
                                   meaning=f"radius of {self.part}"))  # fmt: skip
        return tuple(parameters)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the distance from the sphere minus the reading."""
        n = len(self.names)
        centre = (ca.DM(np.array(self.nominal)[:, :3].T) + ca.reshape(p[: 3 * n], 3, n)) @ y[1:]
        radius = self.radius + (p[3 * n] if self._radius_sd else 0.0)
        return ca.norm_2(seen.device(seen.point) - centre) - radius - y[0]

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each sphere fitted to the nominal robot's points; an unknown radius is the fits' mean."""
        stated, reading, radii = self.series.number("radius"), self.readings(table), list[float]()

        def found(rows: np.ndarray) -> np.ndarray:
            centre, radius = _fitted_sphere(points[rows], reading[rows], stated)
            radii.append(radius)
            return centre

        laid = self.laid(table, found, 4)
        return laid if stated or self.found or not radii else replace(laid, found=float(np.mean(radii)))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the distances from the first sphere."""
        distance = np.linalg.norm(points - np.array(self.nominal[0][:3]), axis=1)
        return np.vstack([distance - self.radius, self.first(len(points))])


def _fitted_sphere(points: np.ndarray, reading: np.ndarray, stated: float | None) -> tuple[np.ndarray, float]:
    """Return a sphere's centre (3,) and radius [m] from points (n, 3) at distances (n,) from its surface."""
    # |point|² - 2 point·centre + |centre|² = radius² is linear in the centre and |centre|² - radius².
    system = np.column_stack([2 * points, np.ones(len(points))])
    *centre, rest = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    radius = stated or float(np.sqrt(max(rest + np.dot(centre, centre), 0.0))) or USUAL_RADIUS

    def residuals(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - x[:3], axis=1) - reading
        return np.append((distance - x[3]) / ROUGH, 0.0 if stated is None else (x[3] - stated) / (1e-6 * stated))

    fitted = scipy.optimize.least_squares(residuals, [*centre, radius], loss="soft_l1").x
    return fitted[:3], float(fitted[3])
