"""A series: rows that one device measured in one way, and what the user says of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Triple = tuple[float, float, float]
Setting = float | str | bool | None | tuple[float, ...]


@dataclass(frozen=True)
class Station:
    """Where a series' device stands: origin [m] and rotation [rad] (about x, y, z in turn) in the measuring frame.

    The first station is the measuring frame. A further one that is not known is found from its rows; by_session says that it,
    or the robot, is set up anew for each session.
    """

    name: str = ""
    known: bool = False
    origin: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)
    by_session: bool = False


@dataclass(frozen=True)
class BeamNoise:
    """A tracker's noise as makers state it: floor + growth · range along the beam [m, m/m], and an angle across it [rad].

    device (3,) is where the tracker stands in the frame that it reports in [m].
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
    """Rows of one kind from one device; settings are what its kind lets a user say of it (SI units).

    kind is an observation's id; empty means position, or pose where orientations were measured. labels are the columns that
    name what was touched, within those that tell the rows of one standstill apart beside its markers.
    """

    name: str = ""
    kind: str = ""
    station: Station = Station()
    beam: BeamNoise | None = None
    settings: tuple[tuple[str, Setting], ...] = ()
    labels: tuple[str, ...] = ()
    within: tuple[str, ...] = ()

    def setting(self, name: str, otherwise: Setting = None) -> Setting:
        """Return what the user said, or what holds otherwise."""
        return dict(self.settings).get(name, otherwise)

    def number(self, name: str) -> float | None:
        """Return a number that the user said, None where there is none."""
        stated = self.setting(name)
        return float(stated) if isinstance(stated, int | float) and not isinstance(stated, bool) else None

    def triple(self, name: str) -> Triple | None:
        """Return three figures that the user said, None where there are none."""
        stated = self.setting(name)
        return (stated[0], stated[1], stated[2]) if isinstance(stated, tuple) and len(stated) == 3 else None

    @staticmethod
    def of(name: str, kind: str, settings: Mapping[str, Setting] | None = None, **more: object) -> Series:
        """Return a series with settings given as a mapping."""
        return Series(name, kind, settings=tuple((settings or {}).items()), **more)  # type: ignore[arg-type]
