"""Same point: the tool again in the same socket, whose place nobody knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
from pydantic import Field

from calflow.files.deferred import pd
from calflow.files.toml import FileModel, Length, Lengths3
from calflow.files.units import METRE
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import UNKNOWN_BOUND, UNKNOWN_SD, Observation, Placement, Seen
from calflow.robot.frames import apply, vector
from calflow.robot.parts import Parameter

APART_BOUND = 20.0  # standard deviations of a known distance
SHORTEST = 1e-6  # m


class SamePointSettings(FileModel):
    """distance_mm of a placement's two sockets, and distance_sd_mm, how surely it is known (0: exactly).

    place_mm is roughly where the first socket will be: for poses that are to be planned, once measured the rows say it. on is the
    link that the sockets are on, another arm's say; none: they stand still.
    """

    on: str = ""

    distance: Length | None = Field(default=None, gt=0)
    distance_sd: Length = Field(default=0.0, ge=0)
    place: Lengths3 | None = None


Point = tuple[float, float, float]


@dataclass(frozen=True)
class Socket:
    """One socket of one placement, and where it is thought to be [m]."""

    placement: str
    socket: str
    point: Point = (0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        """Its name within the series."""
        return "-".join(filter(None, (self.placement, self.socket)))


@dataclass(frozen=True)
class SamePoint(Observation):
    """The marker is at its row's socket; a socket each name in the column `socket`, anew for each `placement`.

    Settings: distance [m] of a placement's two sockets, and distance_sd [m], how surely it is known (0: exactly); place (3,)
    [m] of the first one, roughly, for poses that are to be planned; on, the link whose frame the sockets are in where they move
    with it: another arm's tool that this one touches.
    """

    sockets: tuple[Socket, ...] = ()

    id = "same-point"
    title = "the tool in a socket"
    columns = Reported({"socket": ""}, {}, ("socket", "placement"))
    settings = SamePointSettings
    units = (METRE,) * 3
    touches = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the sockets that the rows name."""
        return cls(series, tuple(Socket(*name) for name in sorted(set(_names(table)))))

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return one socket where the settings say, or two along x where their distance is known."""
        place = series.triple("place")
        if place is None:
            raise ValueError("state where the socket will be, roughly: place_mm = [x, y, z]")
        x, y, z = place
        apart = series.number("distance")
        second = () if apart is None else (Socket("", "2", (x + apart, y, z)),)
        return cls(series, (Socket("", "1", (x, y, z)), *second))

    @property
    def _distance(self) -> float | None:
        return self.series.number("distance")

    @property
    def _pairs(self) -> dict[str, tuple[int, int]]:
        """The two sockets of each placement whose distance is known, by the placement's name."""
        sockets = {name: [k for k, s in enumerate(self.sockets) if s.placement == name] for name in self._placements}
        return {name: (at[0], at[1]) for name, at in sockets.items() if len(at) == 2 and self._distance is not None}

    @property
    def _placements(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(socket.placement for socket in self.sockets))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each socket's place; of two at a known distance the second's direction, and how far the distance errs."""
        second = {b for _, b in self._pairs.values()}
        parameters: list[Parameter] = []
        for k, socket in enumerate(self.sockets):
            part = f"{self.part}-{socket.name}"
            described = [
                (axis, "m", UNKNOWN_SD, UNKNOWN_BOUND, at) for axis, at in zip("xyz", socket.point, strict=True)
            ]
            if k in second:
                described = [(symbol, "rad", UNKNOWN_SD, UNKNOWN_BOUND, 0.0) for symbol in ("turn1", "turn2")]
                if apart := self.series.number("distance_sd"):
                    described.append(("apart", "m", apart, APART_BOUND * apart, 0.0))
            parameters += [
                Parameter(self.id, part, symbol, unit, sd, -bound, bound, figure=at, meaning=f"{symbol} of {part}")
                for symbol, unit, sd, bound, at in described
            ]
        return tuple(parameters)

    @property
    def reports(self) -> int:
        """Which socket it is."""
        return len(self.sockets)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the sockets, one-hot."""
        names = np.array(["\n".join(name) for name in _names(table)], dtype=object)
        which = [names == f"{socket.placement}\n{socket.socket}" for socket in self.sockets]
        return np.array(which, dtype=float).reshape(len(self.sockets), len(table))

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the marker's place less the socket's."""
        place = self._places(p) @ y
        return seen.point - (apply(seen.link(self._on), place) if self._on else place)

    @property
    def _on(self) -> str:
        return str(self.series.setting("on") or "")

    def _places(self, p: ca.SX) -> ca.SX:
        first = {b: a for a, b in self._pairs.values()}
        places: list[ca.SX] = []
        at = 0
        for k, socket in enumerate(self.sockets):
            if k not in first:
                places.append(ca.SX(ca.DM(socket.point)) + p[at : at + 3])
                at += 3
                continue
            along, first_axis, two = _axes(np.subtract(socket.point, self.sockets[first[k]].point))
            turned = ca.DM(along) + p[at] * ca.DM(first_axis) + p[at + 1] * ca.DM(two)
            at += 2
            apart = ca.SX(float(self._distance or 0.0))
            if self.series.number("distance_sd"):
                apart, at = apart + p[at], at + 1
            places.append(places[first[k]] + apart * turned / ca.norm_2(turned))
        return ca.horzcat(*places)

    def registered_on(
        self, links: Callable[[str], np.ndarray], points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame
    ) -> Self:
        """Put each socket in the middle of the nominal robot's points, as the link that it is on has them."""
        if self._on:
            at = links(self._on)
            points = np.einsum("nji,nj->ni", at[:, :3, :3], points - at[:, :3, 3])
        return self.registered(points, rotations, table)

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Put each socket in the middle of points in its frame."""
        which = self.reported(table).astype(bool)
        return replace(self, sockets=tuple(
            replace(socket, point=vector(points[rows].mean(axis=0))) if rows.any() else socket
            for socket, rows in zip(self.sockets, which, strict=True)
        ))  # fmt: skip

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The sockets."""
        return tuple(Placement(f"{self.part}-{socket.name}", socket.point) for socket in self.sockets)

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return it with the sockets of an earlier one."""
        at = {socket: placements[f"{self.part}-{socket.name}"].origin for socket in self.sockets}
        return replace(self, sockets=tuple(replace(socket, point=at[socket]) for socket in self.sockets))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the sockets, in turn."""
        return np.eye(len(self.sockets))[:, np.arange(len(points)) % len(self.sockets)]

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a socket is new."""
        return not set(_names(table)) <= {(socket.placement, socket.socket) for socket in self.sockets}

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new sockets."""
        sockets = {(socket.placement, socket.socket) for socket in self.sockets}
        return replace(
            self, sockets=self.sockets + tuple(Socket(*name) for name in sorted(set(_names(table)) - sockets))
        )


def _names(table: pd.DataFrame) -> list[tuple[str, str]]:
    placements = table["placement"] if "placement" in table else [""] * len(table)
    return [(str(placement), str(socket)) for placement, socket in zip(placements, table["socket"], strict=True)]


def _axes(way: np.ndarray) -> np.ndarray:
    """A unit vector along a way (3,), and two across it."""
    along = way / np.linalg.norm(way) if np.linalg.norm(way) > SHORTEST else np.array([1.0, 0.0, 0.0])
    return np.vstack([along, np.linalg.svd(along[None])[2][1:]])
