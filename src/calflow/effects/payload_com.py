"""Payload centre: a load whose centre is not where the robot file says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Words, payload_variable
from calflow.effects.payload_mass import loaded
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter


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
