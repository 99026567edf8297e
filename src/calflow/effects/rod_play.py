"""Rod play: worn bearings of a loop's rod, whose length changes where the force in it changes its sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Term, Variable, Words
from calflow.effects.torque_backlash import TorqueBacklash
from calflow.robot.mechanism import Row, State, nominal_posture


@dataclass(frozen=True)
class RodPlay(TorqueBacklash):
    """The rod is longer or shorter by b/2, by the sign of the moment about the driven joint's axis, smoothed as gear play is.

    A longer rod moves the rocker as the crank does that turns by as much over its lever about the rod (Norton, Design of
    Machinery, on four-bar loops). The crank's own weight loads the gear, not the rod.
    """

    id = "rod-play"
    title = "play of the loop's rod"
    words = Words(
        "play of the rod", "the rod's bearings change their side where the force in it changes its sign", "play"
    )
    needs = ("masses", "loop")
    told_by = "watch both ends of the rod while a load turns the force in it around"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the crank's turn that moves the rocker as half the play does, signed by the moment."""
        robot, loop = self.robot, self.robot.loop
        if not loop or joint != loop.joint - 1:
            return []
        closure = nominal_posture(robot, state.q).closure
        assert closure  # of a robot with a loop
        lever = loop.crank.length * ca.fabs(ca.sin(closure.rod_angle - state.q[joint]))
        side = ca.tanh(state.bearing[5, joint] / (self.crossing * self.rated[joint]))
        return [Term("b", "m", 2e-4, 5e-3, side / 2 / lever, one_sided=True)]

    def variable(self, joint: int) -> Variable:
        """Return the moment that the rod holds."""
        return Variable(f"moment about the axis of joint {joint}", "Nm", lambda state, row: state.bearing[5, joint - 1])
