"""Tool deflection: a tool or flange that gives way under the payload's weight, and turns with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from calflow.effects.base import Effect, Words, payload_variable
from calflow.effects.cause import parts
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

GIVES_SD, GIVES_BOUND = 3e-7, 1e-5  # m/N
TURNS_SD, TURNS_BOUND = 1e-6, 4e-5  # rad/N
USUAL = 1e3  # N: of a payload whose mass nobody knows

TOOL = "tool"  # the part that gives way under payloads whose masses are known
Shape = Literal["alike", "bracket", "direction"]
ENTRIES = tuple(i if i == j else i + j for j in "xyz" for i in "xyz")  # of a matrix, column by column
GIVES: dict[Shape, tuple[str, ...]] = {
    "alike": ("c",),
    "bracket": ("c",),
    "direction": tuple(f"c{ij}" for ij in ENTRIES),
}
TURNS: dict[Shape, tuple[str, ...]] = {"alike": (), "bracket": ("t",), "direction": tuple(f"t{ij}" for ij in ENTRIES)}


@dataclass(frozen=True)
class ToolDeflection(Effect):
    """Displacement = C · payload's weight F in the flange's frame, C alike in all directions, or any matrix with a turn T · F.

    A bracket along the flange's z gives way across it alone, and turns by t about z x F: a cantilever of length L by
    t = 1.5 c/L (Euler-Bernoulli), so that markers farther out move farther. One that slants or is crooked moves along one axis
    under a force along another, and turns, which matrices say whatever its shape. A payload whose mass nobody knows is a part of
    its own, whose figures are those times its weight.
    """

    shape: Shape = "alike"

    id = "tool-deflection"
    title = "tool deflection"
    forms = {
        "alike": "alike in all directions",
        "bracket": "a bracket along the flange's axis, which turns",
        "direction": "by direction, which turns",
    }
    words = Words("give of the tool", "tool or flange give way under the payload", "give")
    readable = {"m/N": (9.80665e6, "µm/kg")}
    whole = TOOL
    needs = ("payload",)
    told_by = "put a marker on the flange beside those on the tool"

    @property
    def _unknown(self) -> dict[str, int]:
        """The parts of the payloads whose masses nobody knows, and where they are among all."""
        return {f"payload {name}": k for k, (name, load) in enumerate(self.robot.payloads.items()) if load.mass is None}

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliances under known weights, and what each unknown one shifts and turns."""
        known = any(load.mass for load in self.robot.payloads.values()) or not self._unknown
        found = list(self._of(TOOL, "/N", 1.0)) if known else []
        return (*found, *(parameter for part in self._unknown for parameter in self._of(part, "", USUAL)))

    def _of(self, part: str, per: str, usual: float) -> Iterator[Parameter]:
        words = "the tool's give" if part == TOOL else f"the tool's give under {part}"
        lowest = 0.0 if self.shape == "bracket" else -1.0
        for symbol in GIVES[self.shape]:
            sd, bound = GIVES_SD * usual, GIVES_BOUND * usual
            yield Parameter(self.id, part, symbol, f"m{per}", sd, lowest * bound, bound, meaning=words)
        for symbol in TURNS[self.shape]:
            sd, bound = TURNS_SD * usual, TURNS_BOUND * usual
            yield Parameter(self.id, part, symbol, f"rad{per}", sd, lowest * bound, bound, meaning=f"{words}, its turn")

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Shift and turn the flange."""
        link = ca.SX(still.link)
        for part, own in parts(self).items():
            weight = state.link[:3, -1] if part == TOOL else row.payload[self._unknown[part]] * state.down
            link[:, -1] += self._twist(p[own.tolist()], weight)
        return replace(still, link=link)

    def _twist(self, p: ca.SX, weight: ca.SX) -> ca.SX:
        """The flange's small motion (6,) by one part's parameters under a weight (3,)."""
        x, y = weight[0], weight[1]
        if self.shape == "alike":
            return ca.vertcat(p[0] * weight, ca.SX(3, 1))
        if self.shape == "bracket":
            return ca.vertcat(p[0] * x, p[0] * y, 0, -p[1] * y, p[1] * x, 0)
        return ca.vertcat(ca.reshape(p[:9], 3, 3) @ weight, ca.reshape(p[9:], 3, 3) @ weight)

    variable = payload_variable
