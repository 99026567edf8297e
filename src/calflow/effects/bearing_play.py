"""Bearing play: a worn joint bearing that lies against the side to which the moment across its axis presses it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import Effect, Variable, Words
from calflow.effects.base_play import CROSSING, CROSSINGS
from calflow.effects.bearing_compliance import moment_across
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class BearingPlay(Effect):
    """Rotation b/2 · m / |m| at the joint's frame, m = (Mx, My, 0) of all loads that the joint carries.

    It is smaller where |m| is within a share, crossing, of the largest rated torque of the joint and those after it.
    """

    crossing: float = CROSSING

    id = "bearing-play"
    title = "bearing play (tilt to the side of the moment)"
    words = Words("play of the bearing", "the bearing lies against the side to which the moment presses it", "play")
    needs = ("masses",)
    told_by = "pull at the link behind the bearing in all directions, a dial gauge across it"

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return it crossed at once or gradually."""
        return tuple(replace(self, crossing=crossing) for crossing in CROSSINGS)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the play of each joint's bearing."""
        return tuple(
            Parameter(self.id, f"joint{joint}", "b", "rad", 2e-4, 0.0, 10e-3, meaning=f"play of the bearing of joint {joint}",
                      joint=joint)
            for joint in range(1, self.robot.n_joints + 1)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each bearing tilted."""
        bearing, rated = ca.SX(still.bearing), rated_torques(self.robot)
        for i in range(self.robot.n_joints):
            moment = state.bearing[3:5, i]
            gradual = self.crossing * float(rated[i:].max())
            bearing[3:5, i] = p[i] / 2 * moment / ca.sqrt(ca.sumsqr(moment) + gradual**2)
        return replace(still, bearing=bearing)

    def variable(self, joint: int) -> Variable:
        """Return the moment across the joint's axis."""
        return moment_across(joint)
