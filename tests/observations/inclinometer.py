"""An inclinometer on a link: what another package would bring, in one file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np
import pandas as pd
from pydantic import Field

from calflow.files.toml import FileModel
from calflow.files.units import RADIAN, MeasurementUnit
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Observation, Seen
from calflow.robot.parts import Parameter

SD, BOUND = 0.02, 0.5  # rad: by which it may be screwed on askew, and the base may lean
OWN = {
    "pitch": "zero of pitch",
    "tilt": "zero of tilt",
    "rx": "lean of the base about x",
    "ry": "lean of the base about y",
}


class InclinometerSettings(FileModel):
    """The link that it is screwed on, counted from 1."""

    link: int = Field(gt=0)


@dataclass(frozen=True)
class Inclinometer(Observation):
    """pitch = how the link is turned about its z axis against gravity, tilt = how far that axis is from level; zeros added.

    How the base leans is as little known as the zeros.
    """

    id: ClassVar[str] = "inclinometer"
    title: ClassVar[str] = "two angles of a link against gravity"
    columns: ClassVar[Reported] = Reported({"pitch": "angle", "tilt": "angle"})
    settings: ClassVar[type[FileModel]] = InclinometerSettings
    units: ClassVar[tuple[MeasurementUnit, ...]] = (RADIAN, RADIAN)

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation."""
        return cls(series)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the zeros of both angles, and two leans."""
        return tuple(
            Parameter(self.id, self.part, symbol, "rad", SD, -BOUND, BOUND, meaning=words)
            for symbol, words in OWN.items()
        )

    @property
    def reports(self) -> int:
        """Two angles."""
        return 2

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the angles."""
        return table[["pitch", "tilt"]].to_numpy(float).T

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the angles' differences, each within half a turn."""
        down = seen.down()
        leaning = ca.cross(ca.vertcat(p[2:], 0), down) - down
        up = seen.link(f"link{self.series.number('link'):.0f}")[:3, :3].T @ leaning / ca.norm_2(leaning)
        off = ca.vertcat(ca.atan2(up[0], up[1]), ca.asin(up[2])) + p[:2] - y
        return ca.atan2(ca.sin(off), ca.cos(off))

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return nothing turned: poses are planned by derivatives, which no reading changes."""
        return np.zeros((2, len(points)))
