"""Range noise: a measuring device that scatters more the further it looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class RangeNoise(Effect):
    """Standard deviation + g · range, as makers of trackers state it (15 um + 6 um/m): no shift, but a model of the noise."""

    id: ClassVar[str] = "range-noise"
    title: ClassVar[str] = "noise that grows with range"
    words: ClassVar[Words] = Words(
        "noise that grows with range", "the device scatters more the further it looks", "growth"
    )
    whole: ClassVar[str] = "device"
    grows_with: ClassVar[str] = "range"
    needs: ClassVar[tuple[str, ...]] = ("range",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the growth per metre of range."""
        return (Parameter(self.id, "device", "g", "m/m", 1e-5, 0.0, 1e-3, meaning="noise per range"),)

    def scatter(self, p: ca.SX, row: Row) -> ca.SX | float:
        """Add the range's part."""
        return p * row.range if row.range.nnz() else 0.0
