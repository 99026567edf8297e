"""Sphere: a probe's tip on a ball, whose centre nobody knows, nor its radius where that is not stated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
import pandas as pd
from pydantic import Field
from scipy.optimize import least_squares

from calflow.files.toml import FileModel, Length, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import UNKNOWN_BOUND, UNKNOWN_SD, Observation, Placement, Seen
from calflow.robot.frames import vector
from calflow.robot.parts import Parameter

USUAL_RADIUS, RADIUS_SD = 0.025, 0.1  # m: of a ball that nobody measured
FURTHEST = 20.0  # standard deviations of a radius that is known
ROUGH = 5e-3  # m: what a nominal robot may err by, where the centre is looked for
NOWHERE = (0.0, 0.0, 0.0)


class SphereSettings(FileModel):
    """radius_mm from a sphere's centre to the marker, with a probe's tip, and radius_sd_mm, how surely it is known (0: exactly).

    Where it is not stated it is found. centre_mm is roughly where the sphere will be: for poses that are to be planned.
    """

    radius: Length | None = Field(default=None, gt=0)
    radius_sd: Length = Field(default=0.0, ge=0)
    centre: Lengths3 | None = None


@dataclass(frozen=True)
class Sphere(Observation):
    """|marker - centre| - radius = reading (0 where none is reported); a sphere each name in the column `sphere`.

    All spheres of a series have one radius. Settings: radius [m] and radius_sd [m] (0: known exactly), centre (3,) [m],
    roughly, for poses that are to be planned.
    """

    spheres: tuple[str, ...] = ("",)
    centres: tuple[tuple[float, float, float], ...] = (NOWHERE,)
    found: float | None = None  # m: the radius by the rows, where nobody states it

    id = "sphere"
    title = "points on a sphere"
    columns = Reported({}, {"reading": "length"}, ("sphere",))
    settings = SphereSettings
    units = (METRE,)
    touches = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the spheres that the rows name."""
        spheres = tuple(dict.fromkeys(_names(table)))
        return cls(series, spheres, (NOWHERE,) * len(spheres))

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return a sphere where the settings say."""
        centre = series.triple("centre")
        if centre is None:
            raise ValueError("state where the sphere will be, roughly: centre_mm = [x, y, z], and its radius_mm")
        return cls(series, ("",), (centre,))

    def _part(self, sphere: str) -> str:
        return f"{self.part}-{sphere}" if sphere else self.part

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
        found = [
            Parameter(self.id, self._part(sphere), axis, "m", UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND, figure=at,
                      meaning=f"centre of {self._part(sphere)}, {axis}")
            for sphere, centre in zip(self.spheres, self.centres, strict=True)
            for axis, at in zip("xyz", centre, strict=True)
        ]  # fmt: skip
        if sd := self._radius_sd:
            low = max(-FURTHEST * sd, -0.9 * self.radius)
            found.append(Parameter(self.id, self.part, "radius", "m", sd, low, FURTHEST * sd, figure=self.radius,
                                   meaning=f"radius of {self.part}"))  # fmt: skip
        return tuple(found)

    @property
    def reports(self) -> int:
        """A reading, and which sphere it is of."""
        return 1 + len(self.spheres)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings and the spheres."""
        names = np.array(_names(table), dtype=object)
        return np.vstack([_readings(table), *(names == sphere for sphere in self.spheres)]).astype(float)

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the distance from the sphere less the reading."""
        n = len(self.spheres)
        centre = (ca.DM(np.array(self.centres).T) + ca.reshape(p[: 3 * n], 3, n)) @ y[1:]
        radius = self.radius + (p[3 * n] if self._radius_sd else 0.0)
        return ca.norm_2(seen.point - centre) - radius - y[0]

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Lay each sphere through the nominal robot's points; where nobody knows the radius it is the mean of what they say."""
        known, reading, names = self.series.number("radius"), _readings(table), np.array(_names(table), dtype=object)
        found = [_laid(points[names == one], reading[names == one], known) for one in self.spheres]
        centres = tuple(laid[0] if laid else at for laid, at in zip(found, self.centres, strict=True))
        radii = [laid[1] for laid in found if laid]
        radius = self.found if self.found or not radii else float(np.mean(radii))
        return replace(self, centres=centres, found=None if known else radius)

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The centres."""
        return tuple(Placement(self._part(one), at) for one, at in zip(self.spheres, self.centres, strict=True))

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return it with the centres of an earlier one."""
        return replace(self, centres=tuple(placements[self._part(one)].origin for one in self.spheres))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the distances from the first sphere."""
        which = np.zeros((len(self.spheres), len(points)))
        which[0] = 1.0
        return np.vstack([np.linalg.norm(points - np.array(self.centres[0]), axis=1) - self.radius, which])

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return readings of nothing: on the sphere itself."""
        found = self.expected(points, rotations)
        found[0] = 0.0
        return found

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a sphere is new."""
        return not set(_names(table)) <= set(self.spheres)

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new spheres."""
        new = tuple(name for name in dict.fromkeys(_names(table)) if name not in self.spheres)
        return replace(self, spheres=self.spheres + new, centres=self.centres + (NOWHERE,) * len(new))


def _laid(
    points: np.ndarray, reading: np.ndarray, known: float | None
) -> tuple[tuple[float, float, float], float] | None:
    """A sphere's centre and radius [m] from points (n, 3) at distances (n,) from it; None where these are too few."""
    if len(points) < 4:
        return None
    # |point|² - 2 point·centre + |centre|² = radius²: linear but for one unknown.
    system = np.column_stack([2 * points, np.ones(len(points))])
    *centre, rest = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    radius = known or float(np.sqrt(max(rest + np.dot(centre, centre), 0.0))) or USUAL_RADIUS

    def missed(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - x[:3], axis=1) - reading
        return np.append((distance - x[3]) / ROUGH, 0.0 if known is None else (x[3] - known) / (1e-6 * known))

    found = least_squares(missed, [*centre, radius], loss="soft_l1").x
    return vector(found[:3]), float(found[3])


def _readings(table: pd.DataFrame) -> np.ndarray:
    return table["reading"].to_numpy(float) if "reading" in table else np.zeros(len(table))


def _names(table: pd.DataFrame) -> list[str]:
    return [str(name) for name in table["sphere"]] if "sphere" in table else [""] * len(table)
