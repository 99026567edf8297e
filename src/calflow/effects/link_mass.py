"""Link mass: links that are heavier or lighter than the robot file states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Effect, Variable, Words, torque_variable
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class LinkMass(Effect):
    """Mass times 1 + e, for each link."""

    id = "link-mass"
    title = "link mass"
    words = Words("mass error", "the link is not as heavy as the robot file says", "error")
    place_word = "link"
    needs = ("masses",)
    told_by = "compare the motors' torques at standstill with those computed"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one relative error per link."""
        return tuple(
            Parameter(self.id, f"link{i + 1}", "e", "1", 0.2, -0.9, 2.0, meaning=f"error of the mass of link {i + 1}",
                      joint=i + 1)
            for i in range(self.robot.n_joints)
        )  # fmt: skip

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return the loads with the links' masses scaled."""
        return replace(loads, mass=loads.mass * (1 + p))

    def variable(self, joint: int) -> Variable:
        """Return the torque on joint 2 of its chain, to which every link beyond contributes."""
        return torque_variable(self, (*self.robot.chain(joint), 1, 1)[1] + 1)
