"""Marker place: a marker that does not sit where the robot file says beside the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter

PLACE_SD, PLACE_BOUND = 3e-4, 10e-3  # m


@dataclass(frozen=True)
class MarkerPlace(Effect):
    """A marker's point + (x, y, z), where its place beside the others counts as known: a wrong centre, a bent pin."""

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
            for name in self.robot.markers for axis in "xyz"
        )  # fmt: skip

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Shift each marker."""
        return replace(dims, markers=dims.markers + ca.reshape(p, 3, -1))
