"""Marker place: a marker whose place relative to the others is not as the robot file states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter

PLACE_SD, PLACE_BOUND = 3e-4, 10e-3  # m


@dataclass(frozen=True)
class MarkerPlace(Effect):
    """Marker's point + (x, y, z), where its relative place counts as known: a wrong ball centre, a bent pin."""

    id = "marker-place"
    title = "place of a marker on the tool"
    words = Words(
        "wrong place of a marker", "the marker is not where the robot file says beside the others", "distance"
    )
    place_word = "marker"
    needs = ("distances",)
    told_by = "measure the distances between the markers anew, with another device"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift of each marker."""
        return tuple(
            Parameter(self.id, name, axis, "m", PLACE_SD, -PLACE_BOUND, PLACE_BOUND, meaning=f"{axis} of marker {name}")
            for name in self.robot.markers
            for axis in "xyz"
        )

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with each marker shifted."""
        return replace(dims, markers=dims.markers + ca.reshape(p, 3, -1))
