"""Payload centre: a load whose centre is not where the robot file says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words, payload_variable
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class PayloadCom(Effect):
    """Centre + (x, y, z) in the flange's frame, of all payloads alike."""

    id = "payload-com"
    title = "payload centre of mass"
    words = Words("payload centre error", "the payload's centre of mass is not where the robot file says", "distance")
    whole = "payloads"
    needs = ("masses", "payload")
    told_by = "weigh the payload on two supports"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the shift."""
        return tuple(
            Parameter(self.id, "payloads", axis, "m", 0.05, -0.5, 0.5, meaning=f"{axis} of the payloads' centre")
            for axis in "xyz"
        )

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Shift the payloads' centres."""
        return replace(loads, payload_com=loads.payload_com + ca.repmat(p, 1, len(self.robot.payloads)))

    variable = payload_variable
