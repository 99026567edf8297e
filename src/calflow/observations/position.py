"""Position: a device that reports where the marker is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np
import pandas as pd

from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.columns import POSITION, Reported
from calflow.measurements.series import Series, Station
from calflow.observations.base import Observation, Placement, Seen
from calflow.observations.frames import Frames
from calflow.robot.parts import Parameter

HERE = Frames(Station())  # the measuring frame itself


@dataclass(frozen=True)
class Position(Observation):
    """(x, y, z) = R' (marker - origin): the marker in the station's frame, R and origin of which lead to the measuring frame."""

    frames: Frames = HERE

    id: ClassVar[str] = "position"
    title: ClassVar[str] = "position of a marker"
    columns: ClassVar[Reported] = Reported(dict.fromkeys(POSITION, "length"))
    units: ClassVar[tuple[MeasurementUnit, ...]] = (METRE,) * 3
    from_outside: ClassVar[bool] = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame, first: bool = True) -> Self:
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
