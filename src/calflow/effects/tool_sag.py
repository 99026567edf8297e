"""Tool sag: a flange, tool or marker mount that deflects under its own, unknown weight, or lies loose on its lower side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_TOOL, Effect, Variable, Words
from calflow.effects.tool_deflection import TOOL, markers_alone, reach, tools
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

SAG_SD, SAG_BOUND = 1e-4, 5e-3  # m
TURN_SD, TURN_BOUND = 3e-4, 20e-3  # rad

LEVEL = 0.03  # rad from the vertical, within which a loose tool hangs clear of its sides

Shape = Literal["cantilever", "symmetric", "any", "loose"]
ALONG_AXIS = ("cantilever", "loose")  # shapes that are alike all round the flange's axis


@dataclass(frozen=True)
class ToolSag(Effect):
    """Shift = C · u, u gravity's direction in the flange's frame; of a tool with all its markers, or of one marker alone.

    A cantilever along the flange's z sags by c across it, and the tool rotates by t about z x u, so that markers move by
    different amounts. So does a loose one, of a worn tool changer say, but all the way to its lower side wherever that is: u is
    then divided by its length across the flange's axis. Otherwise C is symmetric, as for a bar in any direction (Maxwell's
    reciprocity, 1864), or a full matrix: a marker off the neutral line of its mount moves across gravity too. The isotropic part
    of the tool's C is the same shift of every marker in every pose, so that its last entry is redundant and omitted.
    """

    shape: Shape = "cantilever"

    id = "tool-sag"
    title = "tool sag (own weight)"
    forms = {
        "cantilever": "across the flange's axis",
        "symmetric": "by direction",
        "any": "by direction, one across another",
        "loose": "loose, on its lower side",
    }
    words = Words(
        "sag of the tool",
        "the flange, the tool or a marker's mount sags under its own weight, or is loose and rests on its lower side",
    )
    whole = TOOL
    family = OF_THE_TOOL
    told_by = "put a marker on the flange beside those on the tool, and measure under two payloads"

    @cached_property
    def _tools(self) -> dict[str, int]:
        """The number of each tool, by part."""
        return {part: k for k, part in enumerate(tools(self.robot))}

    @cached_property
    def _markers(self) -> dict[str, int]:
        """The index, by part, of each marker on a tool that has several."""
        return markers_alone(self.robot)

    def _entries(self, part: str) -> list[tuple[int, int]]:
        """Return the entries of C that are a part's parameters."""
        every = [(i, j) for i in range(3) for j in range(3) if self.shape == "any" or i <= j]
        return every[:-1] if part in self._tools else every

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the entries of each part's C; for a cantilever, or a loose tool, its sag, and the tool's rotation."""
        return tuple(parameter for part in (*self._tools, *self._markers) for parameter in self._declare(part))

    def _declare(self, part: str) -> Iterator[Parameter]:
        words = f"sag of {'the tool' if part == TOOL else part} under its own weight"
        if self.shape in ALONG_AXIS:
            yield Parameter(self.id, part, "c", "m", SAG_SD, 0.0, SAG_BOUND, meaning=words)
            if part in self._tools:
                yield Parameter(self.id, part, "t", "rad", TURN_SD, 0.0, TURN_BOUND, meaning=f"{words}, its turn")
            return
        for i, j in self._entries(part):
            symbol = f"c{'xyz'[i]}{'xyz'[j]}" if i != j else f"c{'xyz'[i]}"
            yield Parameter(self.id, part, symbol, "m", SAG_SD, -SAG_BOUND, SAG_BOUND, meaning=words)

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the shift: of a tool that rotates, and may do so alone, that of the farthest marker."""
        turns = self.shape in ALONG_AXIS and p.numel() == 2
        return p[0] + reach(self.robot) * p[1] if turns else super().size(p, own)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection of each tool's link; a marker's own sag acts in that marker's rows alone."""
        link, numbers = ca.SX(still.link), self.robot.tools
        for part, values in self.parts.items():
            whole = part in self._tools
            k = self._tools[part] if whole else numbers.index(self.robot.marker_links[self._markers[part]])
            acts = 1 if whole else row.marker[self._markers[part]]
            link[:, numbers[k]] += acts * self._twist(part, p[values], state.down[:, k])
        return replace(still, link=link)

    def _twist(self, part: str, p: ca.SX, down: ca.SX) -> ca.SX:
        """Return the flange's twist (6,) by one part's parameters."""
        if self.shape == "loose":
            down = down / ca.sqrt(ca.sumsqr(down[:2]) + LEVEL**2)
        if self.shape in ALONG_AXIS:
            turn = p[1] * ca.vertcat(-down[1], down[0], 0) if part in self._tools else ca.SX(3, 1)
            return ca.vertcat(p[0] * down[0], p[0] * down[1], 0, turn)
        shift = ca.SX(3, 1)
        for value, (i, j) in zip(ca.vertsplit(p), self._entries(part), strict=True):
            shift[i] += value * down[j]
            if self.shape == "symmetric" and i != j:
                shift[j] += value * down[i]
        return ca.vertcat(shift, ca.SX(3, 1))

    def variable(self, joint: int) -> Variable:
        """Return the angle between the flange's axis and straight down."""
        return Variable("angle of the flange's axis to the vertical", "deg", _tilt, float(np.rad2deg(1.0)))


def _tilt(state: State, row: Row) -> ca.SX:
    return ca.atan2(ca.norm_2(state.down[:2, -1]), state.down[2, -1])
