"""Position: a device that reports where the marker is, in the frame of its station.

Frames of stations: where a device stood, session by session, relative to the measuring frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.files.deferred import Rotation, pd
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.rows import POSITION, Reported
from calflow.measurements.series import Series, Station
from calflow.observations.base import UNKNOWN_BOUND, UNKNOWN_SD, Observation, Placement, Seen
from calflow.robot.frames import angles, placement
from calflow.robot.parts import Parameter

SYMBOLS = ("x", "y", "z", "rx", "ry", "rz")
Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Frames:
    """The frames of one station that are not the measuring frame: a session each (one of all, ("",), where it stays).

    still holds the session ("" for all) in which the station is the measuring frame itself, if there is one; nominal holds each
    frame's place: origin [m] and angles [rad] about x, y, z in turn. A known frame has no parameters.
    """

    station: Station
    sessions: tuple[str, ...] = ()
    nominal: tuple[Six, ...] = ()
    still: tuple[str, ...] = ()

    @staticmethod
    def of(station: Station, table: pd.DataFrame, first: bool) -> Frames:
        """Return the frames that the rows need; first says whether this station, at its first session, is the measuring frame."""
        sessions = tuple(dict.fromkeys(_sessions(station, table)))
        still = sessions[:1] if first else ()
        stated = (*station.origin, *station.rotation) if station.known else (0.0,) * 6
        others = sessions[len(still) :]
        return Frames(station, others, (stated,) * len(others), still)

    def part(self, session: str) -> str:
        """What a frame is called."""
        return "-".join(filter(None, ("station", self.station.name, session)))

    def parameters(self, kind: str) -> tuple[Parameter, ...]:
        """Return six errors a frame, in its own axes."""
        if self.station.known and not self.station.by_session:
            return ()
        return tuple(
            Parameter(kind, self.part(session), symbol, "m" if k < 3 else "rad", UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND,
                      figure=nominal[k], meaning=f"place of the {self.part(session).replace('-', ' ')}, {symbol}")
            for session, nominal in zip(self.sessions, self.nominal, strict=True) for k, symbol in enumerate(SYMBOLS)
        )  # fmt: skip

    def which(self, table: pd.DataFrame) -> np.ndarray:
        """Return which frame each row is in, one-hot, shape (n_frames, n_rows); no frame is the measuring frame."""
        here = np.array(_sessions(self.station, table), dtype=object)
        return np.array([here == session for session in self.sessions], dtype=float).reshape(
            len(self.sessions), len(table)
        )

    def inverse(self, p: ca.SX, which: ca.SX) -> tuple[ca.SX, ca.SX] | None:
        """Return turn (3, 3) and shift (3,) from the measuring frame into the row's; None where there is no other."""
        if not self.sessions:
            return None
        stands = placement(ca.DM(np.array(self.nominal)).T @ which)
        if p.numel():
            stands = stands @ placement(ca.reshape(p, 6, len(self.sessions)) @ which)
        turn = stands[:3, :3].T
        return turn, -turn @ stands[:3, 3]

    def turns(self, p: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Return how the frames of rows (one-hot, (n_frames, n_rows)) are turned, shape (n_rows, 3, 3)."""
        turn = Rotation.from_euler("XYZ", np.array(self.nominal)[:, 3:])
        if len(p):
            turn = turn * Rotation.from_euler("XYZ", np.reshape(p, (-1, 6))[:, 3:])
        every = np.concatenate([np.eye(3)[None], turn.as_matrix()])
        return np.asarray(every[np.where(which.any(axis=0), 1 + which.argmax(axis=0), 0)])

    def registered(self, points: np.ndarray, measured: np.ndarray, table: pd.DataFrame) -> Frames:
        """Place the frames by the rigid motion that takes measured (n_rows, 3) to points (Kabsch 1976)."""
        if not self.sessions or (self.station.known and not self.station.by_session):
            return self
        frames = list[Six]()
        for rows, before in zip(self.which(table).astype(bool), self.nominal, strict=True):
            if rows.sum() < 3:
                frames.append(before)
                continue
            centre, aim = measured[rows].mean(axis=0), points[rows].mean(axis=0)
            turn, _ = Rotation.align_vectors(points[rows] - aim, measured[rows] - centre)
            x, y, z = map(float, aim - turn.apply(centre))
            rx, ry, rz = map(float, angles(turn))
            frames.append((x, y, z, rx, ry, rz))
        return replace(self, nominal=tuple(frames))

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a session is new."""
        return not set(_sessions(self.station, table)) <= {*self.sessions, *self.still}

    def extended(self, table: pd.DataFrame) -> Frames:
        """Return the frames with those of new sessions."""
        names = {*self.sessions, *self.still}
        new = tuple(name for name in dict.fromkeys(_sessions(self.station, table)) if name not in names)
        return replace(self, sessions=self.sessions + new, nominal=self.nominal + ((0.0,) * 6,) * len(new))

    @property
    def placements(self) -> tuple[Placement, ...]:
        """Each frame's place."""
        return tuple(
            Placement(self.part(session), nominal[:3], nominal[3:])
            for session, nominal in zip(self.sessions, self.nominal, strict=True)
        )

    def placed(self, placements: dict[str, Placement]) -> Frames:
        """Return the frames where an earlier run had them."""
        placed = [placements[self.part(session)] for session in self.sessions]
        return replace(self, nominal=tuple((*placement.origin, *placement.rotation) for placement in placed))


def _sessions(station: Station, table: pd.DataFrame) -> list[str]:
    if not station.by_session or "session" not in table:
        return [""] * len(table)
    return [str(session) for session in table["session"]]


HERE = Frames(Station())  # the measuring frame itself


@dataclass(frozen=True)
class Position(Observation):
    """(x, y, z) = R' (marker - origin): the marker in the station's frame, R and origin of which lead to the measuring frame."""

    frames: Frames = HERE

    id = "position"
    title = "position of a marker"
    columns = Reported(dict.fromkeys(POSITION, "length"))
    units: ClassVar[tuple[MeasurementUnit, ...]] = (METRE,) * 3
    in_station = True
    from_outside = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of a series whose station is the measuring frame."""
        return cls.beside(series, table, first=True)

    @classmethod
    def beside(cls, series: Series, table: pd.DataFrame, first: bool) -> Self:
        """Return the observation; first says whether its station is the measuring frame."""
        return cls(series, Frames.of(series.station, table, first))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of the station's frames."""
        return self.frames.parameters(self.id)

    @property
    def reports(self) -> int:
        """Three coordinates, and which frame they are in."""
        return 3 + len(self.frames.sessions)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the coordinates and the frames."""
        return np.vstack([table[["x", "y", "z"]].to_numpy(float).T, self.frames.which(table)])

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the difference of the positions in the station's frame."""
        frame = self.frames.inverse(p, y[3:])
        point = seen.point if frame is None else frame[0] @ seen.point + frame[1]
        return seen.device(point) - y[:3]

    def axes(self, p: np.ndarray, table: pd.DataFrame) -> np.ndarray | None:
        """Return how the station's frames are turned."""
        return self.frames.turns(p, self.frames.which(table)) if self.frames.sessions else None

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Place the station's frames."""
        return replace(self, frames=self.frames.registered(points, table[["x", "y", "z"]].to_numpy(float), table))

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The station's frames."""
        return self.frames.placements

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return it with the frames of an earlier one."""
        return replace(self, frames=self.frames.placed(placements))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the coordinates."""
        return np.vstack([points.T, np.zeros((len(self.frames.sessions), len(points)))])

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a session is new."""
        return self.frames.lacks(table)

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the frames of new sessions."""
        return replace(self, frames=self.frames.extended(table))
