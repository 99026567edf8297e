"""Misstated payloads: errors of mass or centre of mass, common to all payloads and of each individually."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words, payload_variable
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


def erring(robot: Robot) -> dict[str, ca.DM]:
    """Return, by part, which payloads (n_payloads,) have an error: all a common one, and each with mass, if several, its own."""
    each, heavy = ca.DM.eye(len(robot.payloads)), [k for k, load in enumerate(robot.payloads.values()) if load.mass]
    own = {list(robot.payloads)[k]: each[:, k] for k in heavy} if len(heavy) > 1 else {}
    return {"payloads": ca.DM.ones(len(robot.payloads)), **own}


@dataclass(frozen=True)
class PayloadMass(Effect):
    """Mass (1 + e), with e common to all payloads (one scale, one density) and of each individually."""

    id = "payload-mass"
    title = "payload mass"
    words = Words("payload mass error", "the payload is not as heavy as the robot file says", "error")
    whole = "payloads"
    needs = ("masses", "payload")
    told_by = "weigh the payload"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the common relative error, and that of each payload if there are several."""
        return tuple(
            Parameter(self.id, part, "e", "1", 0.2, -0.9, 2.0, meaning=f"error of the mass of {part}")
            for part in erring(self.robot)
        )

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return the loads with the payloads' masses scaled."""
        return replace(loads, payload_mass=loads.payload_mass * (1 + ca.horzcat(*erring(self.robot).values()) @ p))

    variable = payload_variable


@dataclass(frozen=True)
class PayloadCom(Effect):
    """Centre + (x, y, z) in the flange's frame, common to all payloads (one tool, one frame) and of each individually."""

    id = "payload-com"
    title = "payload centre of mass"
    words = Words(
        "payload centre error",
        "the payload's centre of mass is not where the robot file says, or a fitted tool hides a wrong length of the last link",
        "distance",
    )
    whole = "payloads"
    needs = ("masses", "payload")
    told_by = "weigh the payload on two supports"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the common shift, and that of each payload if there are several."""
        return tuple(
            Parameter(self.id, part, axis, "m", 0.05, -0.5, 0.5, meaning=f"{axis} of the centre of {part}")
            for part in erring(self.robot)
            for axis in "xyz"
        )

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return the loads with the payloads' centres shifted."""
        shifts = ca.reshape(p, 3, -1) @ ca.horzcat(*erring(self.robot).values()).T
        return replace(loads, payload_com=loads.payload_com + shifts)

    variable = payload_variable
