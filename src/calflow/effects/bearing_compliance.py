"""Bearing compliance: joint bearings that tilt off their axes under the moments they carry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import STRUCTURE, Effect, Variable, Words
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter

ASIDE = 0.3  # m: typical distance of a bearing from its joint's frame
TILT_SD, TILT_BOUND = 2e-3, 20e-3  # rad at the largest rated torque of all joints


@dataclass(frozen=True)
class BearingCompliance(Effect):
    """Rotation (cx Mx, cy My) at the joint's frame, M the moment of all loads that the joint carries.

    A bearing at an offset s from its joint's frame takes the moment M - s x F and shifts its load by s x rotation. With
    o = c s for a compliance c equal about x and y, and s small against the moment arm of F, that is to first order a rotation
    (cx Mx, cy My) - o x F across the axis and a shift o x (Mx, My, 0).
    """

    aside: bool = False

    id = "bearing-compliance"
    title = "bearing compliance (tilt off the joint's axis)"
    forms = {False: "at its joint's frame", True: "beside its joint's frame"}
    words = Words("bearing tilt", "the bearing tilts across the joint's axis under load", "compliance")
    family = STRUCTURE
    needs = ("masses",)
    told_by = "watch a marker close behind the bearing while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return two compliances per joint, and their products with the bearing's offset."""
        largest = float(rated_torques(self.robot).max())
        sd, bound = TILT_SD / largest, TILT_BOUND / largest
        symbols = [("cx", "rad/Nm", sd, 0.0, bound), ("cy", "rad/Nm", sd, 0.0, bound)]
        if self.aside:
            symbols += [(f"o{axis}", "rad/N", ASIDE * sd, -ASIDE * bound, ASIDE * bound) for axis in "xyz"]
        return tuple(
            Parameter(self.id, f"joint{i + 1}", symbol, unit, sd, low, high,
                      meaning=f"bearing compliance of joint {i + 1} about {symbol[1]}", joint=i + 1)
            for i in range(self.robot.n_joints) for symbol, unit, sd, low, high in symbols
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each bearing tilted."""
        bearing = ca.SX(still.bearing)
        compliance = ca.reshape(p, len(self.declared) // self.robot.n_joints, self.robot.n_joints)
        bearing[3:5, :] = compliance[:2, :] * state.bearing[3:5, :]
        if self.aside:
            for i in range(self.robot.n_joints):
                force, moment = state.bearing[:3, i], ca.vertcat(state.bearing[3:5, i], 0)
                bearing[3:5, i] -= ca.cross(compliance[2:, i], force)[:2]
                bearing[:3, i] = ca.cross(compliance[2:, i], moment)
        return replace(still, bearing=bearing)

    def variable(self, joint: int) -> Variable:
        """Return the moment across the joint's axis."""
        return moment_across(joint)


def moment_across(joint: int) -> Variable:
    """Return the moment that a joint's bearing carries across its axis."""
    moment = lambda state, row: ca.norm_2(state.bearing[3:5, joint - 1])  # noqa: E731
    return Variable(f"moment across the axis of joint {joint}", "Nm", moment)
