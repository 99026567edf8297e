"""Rod play: worn bearings of a loop's rod, whose length changes where the force in it changes its sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Term, Variable, Words
from calflow.effects.torque_backlash import TorqueBacklash
from calflow.robot.mechanism import Deflection, Row, State, assembly_side, nominal_dimensions, pose


@dataclass(frozen=True)
class RodPlay(TorqueBacklash):
    """The rod is longer or shorter by b/2, by the sign of the moment about the driven joint's axis, smoothed as gear play is.

    The rocker turns to where the loop closes with that rod: where rod and crank line up, no turn of the crank would do as much.
    The crank's own weight loads the gear, not the rod.
    """

    id = "rod-play"
    title = "play of the loop's rod"
    words = Words(
        "play of the rod", "the rod's bearings change their side where the force in it changes its sign", "play"
    )
    needs = ("masses", "loop")
    told_by = "watch both ends of the rod while a load turns the force in it around"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return half the play, by which the rod is longer, signed so that the rocker gives way to the moment."""
        loop = self.robot.loop
        if not loop or joint != loop.joint - 1:
            return []
        side = ca.tanh(state.bearing[5, joint] / (self.crossing * self.rated[joint]))
        return [Term("b", "m", 2e-4, 5e-3, -assembly_side(self.robot) * side / 2, one_sided=True)]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the rocker turned to where the loop closes."""
        loop = self.robot.loop
        if not loop:
            return still
        joint, dims, bearing = loop.joint - 1, nominal_dimensions(self.robot), ca.SX(still.bearing)
        longer = super().deflection(p, state, row, still).joint[joint]

        def rocker(rod: ca.SX | float) -> ca.SX:
            stretched = replace(dims, bars=dims.bars + ca.vertcat(0, rod, 0))
            closure = pose(self.robot, stretched, state.q, still).closure
            assert closure  # of a robot with a loop
            return closure.rocker_angle

        bearing[5, joint] = rocker(longer) - rocker(0.0)
        return replace(still, bearing=bearing)

    def variable(self, joint: int) -> Variable:
        """Return the moment that the rod holds."""
        return Variable(f"moment about the axis of joint {joint}", "Nm", lambda state, row: state.bearing[5, joint - 1])
