"""Joint eccentricity: encoder discs and gears that are off-centre, oval or tilted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

from calflow.effects.base import JOINT_ALONE, TRANSMISSION, JointError, Term, Words, phases
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class JointEccentricity(JointError):
    """dq = A cos(order q) + B sin(order q), of first order (off-centre) or second (oval, or tilted), or of both together.

    A disc that is off-centre is often tilted, too: by the larger order alone the sum would have a wrong size.
    """

    order: int = 1
    and_second: bool = False

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

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return either order, and both."""
        forms = super().variants(robot, data)
        return (*forms, *(replace(form, and_second=True) for form in forms[:1]))

    def same_as(self, other: Self) -> bool:
        """Whether both have a wave of the same order."""
        return self.order == other.order or self.and_second or other.and_second

    @property
    def detail(self) -> str:
        """The order, or both."""
        return "orders 1 and 2" if self.and_second else super().detail

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cosine and sine terms."""
        if self.robot.joints[joint].kind == "prismatic":
            return []
        angle, unit = state.q[joint], self.unit(joint)
        second = [replace(term, symbol=f"{term.symbol}2") for term in phases(2 * angle, unit, 1e-3, 20e-3)]
        return [*phases(self.order * angle, unit, 1e-3, 20e-3), *(second if self.and_second else [])]
