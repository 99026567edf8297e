"""Base play: a foot that rocks on loose bolts, to the side to which the overturning moment presses it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter

CROSSING = 0.01  # share of the largest rated torque within which the foot crosses its play
CROSSINGS = (0.01, 0.03, 0.1)  # searched beside the best line
LINES = tuple(np.deg2rad(np.arange(0, 180, 7.5)).tolist())  # rad from x: lines searched


@dataclass(frozen=True)
class BasePlay(Effect):
    """Tilt b/2 · sign(M · u) of the base about a level line u, M the overturning moment; the sign smoothed to tanh.

    about is the angle of the line from the base's x axis [rad]: that between the bolts which hold and those which do not.
    """

    about: float = 0.0
    crossing: float = CROSSING

    id = "base-play"
    title = "base play (foot that rocks on loose bolts)"
    forms: ClassVar[Mapping[Any, str]] = dict.fromkeys(LINES, "")
    words = Words("play of the base", "the foot rocks where the overturning moment changes its side", "play")
    whole = "base"
    needs = ("masses", "floor")
    told_by = (
        "watch a marker on the robot's foot while the arm reaches from one side to the other, and tighten its bolts"
    )

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return lines about this one, each crossed at once or gradually."""
        lines = self.about + np.linspace(-0.5, 0.5, 9) * LINES[1]
        return tuple(replace(self, about=float(line), crossing=crossing) for line in lines for crossing in CROSSINGS)

    @property
    def detail(self) -> str:
        """The line."""
        return f"about a line at {np.rad2deg(self.about) % 180:.3g} deg from the base's x axis"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the play."""
        return (Parameter(self.id, "base", "b", "rad", 3e-4, 0.0, 10e-3, meaning="play of the foot"),)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the base tilted."""
        line = ca.DM([np.cos(self.about), np.sin(self.about)])
        side = ca.tanh(ca.dot(state.link[3:5, 0], line) / (self.crossing * float(rated_torques(self.robot).max())))
        link = ca.SX(still.link)
        link[3:5, 0] = p[0] / 2 * side * line
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the moment about the line."""
        line = ca.DM([np.cos(self.about), np.sin(self.about)])
        return Variable("overturning moment about the line", "Nm", lambda state, row: ca.dot(state.link[3:5, 0], line))
