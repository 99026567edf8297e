"""Axis wobble: a joint's axis that tilts as it turns, by a bearing that does not run true."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import casadi as ca

from calflow.effects.base import Effect, Words, joint_variable
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

TILT_SD, TILT_BOUND = 1e-4, 5e-3  # rad: races of 0.2 m that run out by some 0.01 mm
AMPLITUDES = tuple(product(("cos", "sin"), "xy"))


@dataclass(frozen=True)
class AxisWobble(Effect):
    """Rotation (rx, ry) across the axis at the joint's frame, A cos(order q) + B sin(order q): tilt error motion (ISO 230-7).

    The frame turns with the joint. A tilt that turns with it is geometry, and one towards a side of the housing of the first
    order; races of two lobes tilt by the first and third.
    """

    order: int = 1

    id = "axis-wobble"
    title = "axis wobble (tilt error motion)"
    forms = {1: "order 1", 2: "order 2"}
    words = Words("axis wobble", "the joint's axis tilts as it turns: its bearing does not run true", "tilt")
    side_by_side = True
    told_by = "watch two markers far apart on the link while the joint turns alone"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the amplitudes of the tilt about both axes, of each joint that turns."""
        return tuple(
            Parameter(self.id, f"joint{i + 1}", f"{wave}_{axis}", "rad", TILT_SD, -TILT_BOUND, TILT_BOUND,
                      meaning=f"wobble of joint {i + 1} about {axis}, {wave}", joint=i + 1)
            for i in self._turning for wave, axis in AMPLITUDES
        )  # fmt: skip

    @property
    def _turning(self) -> tuple[int, ...]:
        """Indices of the joints that turn."""
        return tuple(i for i, joint in enumerate(self.robot.joints) if joint.kind == "revolute")

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each axis tilted."""
        bearing = ca.SX(still.bearing)
        for i, amplitudes in zip(self._turning, ca.vertsplit(p, len(AMPLITUDES)), strict=True):
            angle = self.order * state.q[i]
            bearing[3:5, i] = amplitudes[:2] * ca.cos(angle) + amplitudes[2:] * ca.sin(angle)
        return replace(still, bearing=bearing)

    variable = joint_variable
