"""A spring balance between the tool and a hook: what another package would bring, in one file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np
import pandas as pd
from pydantic import Field

from calflow.files.toml import FileModel, Lengths3
from calflow.files.units import NEWTON, MeasurementUnit
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.observations.base import Observation, Seen
from calflow.robot.parts import Parameter

HOOK_SD, HOOK_BOUND = 5e-3, 0.1  # m
PRELOAD_SD, PRELOAD_BOUND = 5.0, 100.0  # N


class SpringBalanceSettings(FileModel):
    """Where the spring is hooked up, in the measuring frame, and how many newtons a metre it pulls."""

    hook: Lengths3
    newtons_per_metre: float = Field(gt=0)


@dataclass(frozen=True)
class SpringBalance(Observation):
    """tension = stiffness · |marker - hook| - preload; the hook's place and the preload are not known well."""

    id: ClassVar[str] = "spring-balance"
    title: ClassVar[str] = "tension of a spring between the marker and a hook"
    columns: ClassVar[Reported] = Reported({"tension": "force"}, sigma="force")
    settings: ClassVar[type[FileModel]] = SpringBalanceSettings
    units: ClassVar[tuple[MeasurementUnit, ...]] = (NEWTON,)

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation."""
        return cls(series)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the errors of the hook's place, and the preload."""
        part, hook = self.part, self._hook
        return (
            *(
                Parameter(
                    self.id, part, axis, "m", HOOK_SD, -HOOK_BOUND, HOOK_BOUND, figure=figure, meaning=f"hook, {axis}"
                )
                for axis, figure in zip("xyz", hook, strict=True)
            ),
            Parameter(self.id, part, "preload", "N", PRELOAD_SD, -PRELOAD_BOUND, PRELOAD_BOUND, meaning="preload"),
        )

    @property
    def reports(self) -> int:
        """One tension."""
        return 1

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the tension."""
        return table[["tension"]].to_numpy(float).T

    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the difference of the tensions."""
        length = ca.norm_2(seen.point - (ca.DM(self._hook) + p[:3]))
        return (self.series.number("newtons_per_metre") or 1.0) * length - p[3] - y

    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the tensions without preload."""
        length = np.linalg.norm(points - np.array(self._hook), axis=1)
        return (self.series.number("newtons_per_metre") or 1.0) * length[None]

    @property
    def _hook(self) -> tuple[float, float, float]:
        return self.series.triple("hook") or (0.0, 0.0, 0.0)
