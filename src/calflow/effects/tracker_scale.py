"""Tracker scale: a scale error of the measuring device."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class TrackerScale(Effect):
    """Reported position times 1 + s; indistinguishable from a scale of all links and the tool without known distances."""

    id = "tracker-scale"
    title = "scale of the measuring device"
    words = Words("scale error of the measuring device", "the device's metre is too long or too short", "error")
    readable = {"1": (1e6, "µm/m")}
    whole = "device"
    needs = ("distances",)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the scale error."""
        return (Parameter(self.id, "device", "s", "1", 3e-5, -1e-3, 1e-3, meaning="scale error"),)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return the point, scaled."""
        return point * (1 + p)
