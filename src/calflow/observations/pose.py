"""Pose: a device that reports the position of a marker and the orientation of the tool."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.files.deferred import pd
from calflow.files.units import METRE, RADIAN
from calflow.measurements.measurements import rotations
from calflow.measurements.rows import POSES
from calflow.observations.base import Seen
from calflow.observations.position import Position


@dataclass(frozen=True)
class Pose(Position):
    """x, y, z of the marker and the orientation of the tool, in the station's frame."""

    id = "pose"
    title = "position of a marker and orientation of the tool"
    columns = POSES
    units = (METRE,) * 3 + (RADIAN,) * 3
    of_row = 12  # the coordinates and a rotation matrix

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the coordinates, the rotation matrices column by column, and the one-hot frames."""
        position = table[["x", "y", "z"]].to_numpy(float).T
        turned = rotations(table).transpose(0, 2, 1).reshape(len(table), 9).T
        return np.vstack([position, turned, *self.which(table)])

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the position error, and 2 sin(angle/2) times the axis of the rotation from measured to predicted orientation."""
        frame = self.inverse(p, y[12:])
        point, rotation = seen.point, seen.rotation()
        if frame is not None:
            point, rotation = frame[0] @ point + frame[1], frame[0] @ rotation
        turn = ca.reshape(y[3:12], 3, 3).T @ rotation
        axis = ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) / 2
        return ca.vertcat(seen.device(point) - y[:3], axis / ca.sqrt(ca.fmax((1 + ca.trace(turn)) / 4, 1e-12)))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the coordinates and the rotations."""
        turned = rotations.transpose(0, 2, 1).reshape(len(points), 9).T
        return np.vstack([points.T, turned, np.zeros((len(self.names), len(points)))])
