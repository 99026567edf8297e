"""Range noise: a measuring device whose noise grows with the measured range."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class RangeNoise(Effect):
    """Standard deviation + g · range, as laser trackers are specified (15 um + 6 um/m): a model of the noise, without shift."""

    id = "range-noise"
    title = "noise that grows with range"
    words = Words("noise that grows with range", "the device scatters more the further it looks", "growth")
    whole = "device"
    grows_with = "range"
    needs = ("range",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the growth per metre of range."""
        return (Parameter(self.id, "device", "g", "m/m", 1e-5, 0.0, 1e-3, meaning="noise per range"),)

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Return the part of the standard deviation that grows with range."""
        return p * row.range if row.range.nnz() else 0.0
