"""A series: rows measured by one device in one way, with the device's station, noise and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calflow.files.deferred import pd

Triple = tuple[float, float, float]
Setting = float | str | bool | None | tuple[float, ...]


@dataclass(frozen=True)
class Station:
    """The pose of a series' device in the measuring frame: origin [m] and rotation [rad] (about x, y, z in turn).

    The first station defines the measuring frame. A further one that is not known is estimated from its rows;
    by_session states that it, or the robot, is set up anew for each session.
    """

    name: str = ""
    known: bool = False
    origin: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)
    by_session: bool = False


@dataclass(frozen=True)
class BeamNoise:
    """A tracker's standard deviations: floor + growth · range [m, m/m] along the beam, angle · range [rad] across it.

    device (3,) [m]: the tracker's position in the frame of the reported positions.
    """

    floor: float
    growth: float
    angle: float
    device: Triple = (0.0, 0.0, 0.0)

    def covariance(self, position: np.ndarray) -> np.ndarray:
        """Return the covariance (n, 3, 3) [m²] of reported positions (n, 3) [m]."""
        beam = position - np.array(self.device)
        distance = np.linalg.norm(beam, axis=1)
        along = beam / np.maximum(distance, 1e-12)[:, None]
        outer = along[:, :, None] * along[:, None, :]
        across = (self.angle * distance) ** 2
        return (self.floor + self.growth * distance)[:, None, None] ** 2 * outer + across[:, None, None] * (
            np.eye(3) - outer
        )


@dataclass(frozen=True)
class Series:
    """Rows of one kind of observation from one device; settings are the user's options of that kind (SI units).

    kind is an observation's id; empty means position, or pose if orientations were measured. labels are the columns
    that name the touched object, within those that, with the marker, distinguish the rows of one standstill.
    """

    name: str = ""
    kind: str = ""
    station: Station = Station()
    beam: BeamNoise | None = None
    settings: tuple[tuple[str, Setting], ...] = ()
    labels: tuple[str, ...] = ()
    within: tuple[str, ...] = ()

    @property
    def has_positions(self) -> bool:
        """Whether it reports positions, or poses, from a station."""
        return self.kind in ("", "position", "pose")

    @property
    def device(self) -> str:
        """Name of its device: positions from one station are of one, and so is every other series."""
        if self.has_positions:
            return " ".join(filter(None, ("station", self.station.name)))
        return self.name or self.kind

    def kind_in(self, table: pd.DataFrame) -> str:
        """Return the kind of a table that has the rows of this series alone."""
        return self.kind or ("pose" if {"rx", "qw"} & set(table) else "position")

    def setting(self, name: str, otherwise: Setting = None) -> Setting:
        """Return the value of a setting, or the default if the user stated none."""
        return dict(self.settings).get(name, otherwise)

    def number(self, name: str) -> float | None:
        """Return the value of a numeric setting; None if there is none."""
        stated = self.setting(name)
        return float(stated) if isinstance(stated, int | float) and not isinstance(stated, bool) else None

    def triple(self, name: str) -> Triple | None:
        """Return the value of a setting of three numbers; None if there is none."""
        stated = self.setting(name)
        return (stated[0], stated[1], stated[2]) if isinstance(stated, tuple) and len(stated) == 3 else None

    @staticmethod
    def of(name: str, kind: str, settings: Mapping[str, Setting] | None = None, **more: object) -> Series:
        """Return a series from settings given as a mapping."""
        return Series(name, kind, settings=tuple((settings or {}).items()), **more)  # type: ignore[arg-type]
