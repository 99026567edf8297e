"""Tool deflection: a tool or flange that gives way under the payload's weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

import casadi as ca

from calflow.effects.base import Effect, Readable, Variable, Words
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot
from calflow.robot.statics import State

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements

GIVES_SD, GIVES_BOUND = 3e-7, 1e-5  # m/N


@dataclass(frozen=True)
class ToolDeflection(Effect):
    """Displacement = C · payload's weight in the flange's frame; C alike in all directions, or one for each axis."""

    directions: int = 1

    id: ClassVar[str] = "tool-deflection"
    title: ClassVar[str] = "tool deflection"
    words: ClassVar[Words] = Words("give of the tool", "tool or flange give way under the payload", "give")
    readable: ClassVar[Readable] = {"m/N": (9.80665e6, "µm/kg")}
    whole: ClassVar[str] = "tool"
    needs: ClassVar[tuple[str, ...]] = ("payload",)
    told_by: ClassVar[str] = "put a marker on the flange beside those on the tool"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return one compliance, and three."""
        return cls(robot, 1), cls(robot, 3)

    @property
    def detail(self) -> str:
        """Say how many compliances."""
        return "alike in all directions" if self.directions == 1 else "by direction"

    @property
    def _symbols(self) -> Sequence[str]:
        return ("c",) if self.directions == 1 else ("cx", "cy", "cz")

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliances."""
        return tuple(
            Parameter(self.id, "tool", symbol, "m/N", GIVES_SD, -GIVES_BOUND, GIVES_BOUND, meaning="the tool's give")
            for symbol in self._symbols
        )

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Shift the flange."""
        link = ca.SX(still.link)
        link[:3, -1] = (p if self.directions == 3 else ca.repmat(p, 3, 1)) * state.link[:3, -1]
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the payload's mass."""
        masses = ca.DM([load.mass for load in self.robot.payloads.values()])
        return Variable("payload", "kg", lambda state, row: ca.dot(masses, row.payload))
