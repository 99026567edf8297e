"""Same point: the tool brought repeatedly to a socket whose position is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np
from pydantic import Field

from calflow.files.deferred import pd
from calflow.files.toml import FileModel, Length, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Links, Name, OfThings, Seen, six
from calflow.robot.frames import apply
from calflow.robot.parts import UNKNOWN_BOUND, UNKNOWN_SD, Parameter

APART_BOUND = 20.0  # standard deviations of a known distance
SHORTEST_DISTANCE = 1e-6  # m


class SamePointSettings(FileModel):
    """distance_mm of a placement's two sockets, and distance_sd_mm, its standard deviation (0: known exactly).

    place_mm is the approximate position of the first socket, for planning poses; measured rows determine it themselves. on is
    the link that carries the sockets, another arm's say; by default they are fixed.
    """

    on: str = ""

    distance: Length | None = Field(default=None, gt=0)
    distance_sd: Length = Field(default=0.0, ge=0)
    place: Lengths3 | None = None


@dataclass(frozen=True)
class SamePoint(OfThings):
    """The marker is at its row's socket; one socket per name in the column `socket` and per `placement`.

    Settings: distance [m] of a placement's two sockets, and distance_sd [m], its standard deviation (0: known exactly); place
    (3,) [m] of the first one, approximate, for planning poses; on, the link that carries the sockets if they move with it:
    another arm's tool that this one touches.
    """

    labelled_by = ("placement", "socket")
    id = "same-point"
    title = "the tool in a socket"
    columns = Reported({"socket": ""}, {}, ("socket", "placement"))
    settings = SamePointSettings
    units = (METRE,) * 3
    touches = True

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return one socket at the position stated in the settings, or two along x where their distance is known."""
        place = series.triple("place")
        if place is None:
            raise ValueError("state where the socket will be, roughly: place_mm = [x, y, z]")
        (x, *more), apart = place, series.number("distance")
        places = [place] if apart is None else [place, (x + apart, *more)]
        return cls(series, (("", "1"), ("", "2"))[: len(places)], tuple(map(six, places)))

    @property
    def _distance(self) -> float | None:
        return self.series.number("distance")

    @property
    def _pairs(self) -> dict[int, int]:
        """Index of the first socket by that of the second, for each placement of two sockets at a known distance."""
        numbers: dict[Name, list[int]] = {}
        for k, name in enumerate(self.names):
            numbers.setdefault(name[:-1], []).append(k)
        return {at[1]: at[0] for at in numbers.values() if len(at) == 2 and self._distance is not None}

    def new(self, table: pd.DataFrame) -> list[Name]:
        """Return the names of new sockets, sorted."""
        return sorted(super().new(table))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each socket's position; for the second of a pair at known distance its direction and the distance's error."""
        parameters: list[Parameter] = []
        for k, (name, place) in enumerate(zip(self.names, self.nominal, strict=True)):
            part = self.part_of(name)
            described = [(axis, "m", UNKNOWN_SD, UNKNOWN_BOUND, at) for axis, at in zip("xyz", place[:3], strict=True)]
            if k in self._pairs:
                described = [(symbol, "rad", UNKNOWN_SD, UNKNOWN_BOUND, 0.0) for symbol in ("turn1", "turn2")]
                if apart := self.series.number("distance_sd"):
                    described.append(("apart", "m", apart, APART_BOUND * apart, 0.0))
            parameters += [
                Parameter(self.id, part, symbol, unit, sd, -bound, bound, figure=at, meaning=f"{symbol} of {part}")
                for symbol, unit, sd, bound, at in described
            ]
        return tuple(parameters)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the one-hot sockets."""
        return np.array(self.which(table), dtype=float).reshape(len(self.names), len(table))

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the marker's position minus the socket's."""
        place = self._places(p) @ y
        return seen.point - apply(seen.link(self._on), place) if self._on else seen.device(seen.point) - place

    @property
    def _on(self) -> str:
        return str(self.series.setting("on") or "")

    def _places(self, p: ca.SX) -> ca.SX:
        first, points = self._pairs, np.array(self.nominal)[:, :3]
        places: list[ca.SX] = []
        at = 0
        for k, point in enumerate(points):
            if k not in first:
                places.append(ca.SX(ca.DM(point)) + p[at : at + 3])
                at += 3
                continue
            along, first_axis, two = _axes(point - points[first[k]])
            turned = ca.DM(along) + p[at] * ca.DM(first_axis) + p[at + 1] * ca.DM(two)
            at += 2
            apart = ca.SX(float(self._distance or 0.0))
            if self.series.number("distance_sd"):
                apart, at = apart + p[at], at + 1
            places.append(places[first[k]] + apart * turned / ca.norm_2(turned))
        return ca.horzcat(*places)

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each socket at the mean of the nominal robot's points, in the frame of its link."""
        if self._on:
            at = links(self._on)
            points = np.einsum("nji,nj->ni", at[:, :3, :3], points - at[:, :3, 3])
        return self.laid(table, lambda rows: points[rows].mean(axis=0))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the sockets, in turn."""
        return np.eye(len(self.names))[:, np.arange(len(points)) % len(self.names)]


def _axes(way: np.ndarray) -> np.ndarray:
    """Return a unit vector along a direction (3,), and two perpendicular to it."""
    along = way / np.linalg.norm(way) if np.linalg.norm(way) > SHORTEST_DISTANCE else np.array([1.0, 0.0, 0.0])
    return np.vstack([along, np.linalg.svd(along[None])[2][1:]])
