"""Position: a device that reports the position of a marker in the frame of its station.

A station's frame is the pose of the device relative to the measuring frame, one per session if it was set up anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.files.deferred import Rotation, pd
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.rows import POSITION, Reported
from calflow.measurements.series import Series
from calflow.observations.base import NOWHERE, PLACE, Links, Name, OfThings, Seen, Six
from calflow.robot.frames import motion_onto
from calflow.robot.parts import UNKNOWN_BOUND, UNKNOWN_SD, Parameter


@dataclass(frozen=True)
class Position(OfThings):
    """(x, y, z) = R' (marker - origin): the marker in the station's frame, of pose (R, origin) in the measuring frame.

    Its objects are the station's frames other than the measuring frame: one per session, or a single one, "", for a device that
    stays. still holds the session ("" for all) in which the station is the measuring frame, if there is one. A known frame
    has no parameters.
    """

    still: tuple[Name, ...] = ()

    id = "position"
    title = "position of a marker"
    columns = Reported(dict.fromkeys(POSITION, "length"))
    units: ClassVar[tuple[MeasurementUnit, ...]] = (METRE,) * 3
    labelled_by = ("session",)
    of_row = 3  # the coordinates
    in_station = True
    from_outside = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of a series whose station is the measuring frame."""
        return cls.beside(series, table, first=True)

    @classmethod
    def beside(cls, series: Series, table: pd.DataFrame, first: bool) -> Self:
        """Return the observation; first: whether its station, in its first session, is the measuring frame."""
        still = tuple(cls(series).labels(table)[:1]) if first else ()
        return cls(series, still=still).extended(table)

    @property
    def begun(self) -> Six:
        """Pose of a frame before registration: the station's, where it is known."""
        station = self.series.station
        return (*station.origin, *station.rotation) if station.known else NOWHERE

    @property
    def part(self) -> str:
        """Name of its station, as the parameters' part."""
        return "-".join(filter(None, ("station", self.series.station.name)))

    @property
    def _is_known(self) -> bool:
        return self.series.station.known and not self.series.station.by_session

    def labels(self, table: pd.DataFrame) -> list[Name]:
        """Return each row's session where sessions have frames of their own, else an empty name."""
        return super().labels(table) if self.series.station.by_session else [("",)] * len(table)

    def new(self, table: pd.DataFrame) -> list[Name]:
        """Return the sessions without a frame so far."""
        return [session for session in super().new(table) if session not in self.still]

    def parameters(self) -> tuple[Parameter, ...]:
        """Return six pose errors per frame, in its own axes."""
        return () if self._is_known else tuple(
            Parameter(self.id, self.part_of(session), symbol, unit, UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND,
                      figure=figure, meaning=f"place of the {self.part_of(session).replace('-', ' ')}, {symbol}")
            for session, nominal in zip(self.names, self.nominal, strict=True)
            for (symbol, unit), figure in zip(PLACE.items(), nominal, strict=True)
        )  # fmt: skip

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the coordinates and the one-hot frames."""
        return np.vstack([table[["x", "y", "z"]].to_numpy(float).T, *self.which(table)])

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the position error in the station's frame."""
        frame = self.inverse(p, y[3:])
        point = seen.point if frame is None else frame[0] @ seen.point + frame[1]
        return seen.device(point) - y[:3]

    def inverse(self, p: ca.SX, which: ca.SX) -> tuple[ca.SX, ca.SX] | None:
        """Return rotation (3, 3) and shift (3,) from the measuring frame to the row's frame; None where it is the only one."""
        if not self.names:
            return None
        stands = self.frame(p, which)
        turn = stands[:3, :3].T
        return turn, -turn @ stands[:3, 3]

    def axes(self, p: np.ndarray, table: pd.DataFrame) -> np.ndarray | None:
        """Return the axes of each row's station frame, (n_rows, 3, 3)."""
        if not self.names:
            return None
        turn = Rotation.from_euler("XYZ", np.array(self.nominal)[:, 3:])
        if len(p):
            turn = turn * Rotation.from_euler("XYZ", np.reshape(p, (-1, 6))[:, 3:])
        every, which = np.concatenate([np.eye(3)[None], turn.as_matrix()]), np.array(self.which(table))
        return np.asarray(every[np.where(which.any(axis=0), 1 + which.argmax(axis=0), 0)])

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with each frame placed by the rigid motion from measured to nominal points."""
        measured = table[["x", "y", "z"]].to_numpy(float)
        if self._is_known:
            return self
        return self.laid(table, lambda rows: motion_onto(measured[rows], points[rows]), 3)

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the coordinates."""
        return np.vstack([points.T, np.zeros((len(self.names), len(points)))])
