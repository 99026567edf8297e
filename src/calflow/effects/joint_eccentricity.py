"""Joint eccentricity: encoder discs and gears that are off-centre, oval or tilted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words, phases
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class JointEccentricity(JointError):
    """dq = A cos(order q) + B sin(order q), of first order (off-centre) or second (oval, or tilted)."""

    order: int = 1

    id = "joint-eccentricity"
    title = "eccentricity"
    forms = {1: "order 1", 2: "order 2"}
    words = Words(
        "eccentricity",
        "a gear or an encoder disc does not run true, so that the angle is off as the joint turns",
        "amplitude",
    )
    family = TRANSMISSION
    side_by_side = True
    told_by = JOINT_ALONE

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cosine and sine terms."""
        if self.robot.joints[joint].kind == "prismatic":
            return []
        return phases(self.order * state.q[joint], self.unit(joint), 1e-3, 20e-3)
