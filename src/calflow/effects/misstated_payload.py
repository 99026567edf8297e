"""A payload that is not what the robot file says: its mass, or its centre, of all payloads alike and of each alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words, payload_variable
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


def loaded(robot: Robot) -> list[str]:
    """Return the payloads that may each be misstated by itself: those with mass, where there are several."""
    heavy = [name for name, load in robot.payloads.items() if load.mass]
    return heavy if len(heavy) > 1 else []


@dataclass(frozen=True)
class PayloadMass(Effect):
    """Mass (1 + e), of all payloads alike (one scale, one density) and of each alone."""

    id = "payload-mass"
    title = "payload mass"
    words = Words("payload mass error", "the payload is not as heavy as the robot file says", "error")
    whole = "payloads"
    needs = ("masses", "payload")
    told_by = "weigh the payload"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return a relative error of all, and of each where there are several."""
        return tuple(
            Parameter(self.id, part, "e", "1", 0.2, -0.9, 2.0, meaning=f"error of the mass of {part}")
            for part in ("payloads", *loaded(self.robot))
        )

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Make the payloads heavier."""
        names, factor = list(self.robot.payloads), ca.SX.ones(len(self.robot.payloads), 1) * (1 + p[0])
        for k, name in enumerate(loaded(self.robot)):
            factor[names.index(name)] += p[k + 1]
        return replace(loads, payload_mass=loads.payload_mass * factor)

    variable = payload_variable


@dataclass(frozen=True)
class PayloadCom(Effect):
    """Centre + (x, y, z) in the flange's frame, of all payloads alike (one tool, one frame) and of each alone."""

    id = "payload-com"
    title = "payload centre of mass"
    words = Words("payload centre error", "the payload's centre of mass is not where the robot file says", "distance")
    whole = "payloads"
    needs = ("masses", "payload")
    told_by = "weigh the payload on two supports"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift of all, and of each where there are several."""
        return tuple(
            Parameter(self.id, part, axis, "m", 0.05, -0.5, 0.5, meaning=f"{axis} of the centre of {part}")
            for part in ("payloads", *loaded(self.robot)) for axis in "xyz"
        )  # fmt: skip

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Shift the payloads' centres."""
        names, shifts = list(self.robot.payloads), ca.reshape(p, 3, -1)
        centres = loads.payload_com + ca.repmat(shifts[:, 0], 1, len(names))
        for k, name in enumerate(loaded(self.robot)):
            centres[:, names.index(name)] += shifts[:, k + 1]
        return replace(loads, payload_com=centres)

    variable = payload_variable
