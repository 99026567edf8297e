"""Link torsion: links that twist about their own axis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from calflow.effects.base import STRUCTURE, Effect, Words
from calflow.effects.link_bending import SHORTEST, SOFT_BOUND, SOFT_SD, Span, end_moment, spans
from calflow.robot.mechanism import Deflection, FrameChain, Row, State, nominal_dimensions, rated_torques, span, to_axis
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

PARALLEL = 1e-6  # m beside the next joint's axis, within which the link's twist is that joint's own compliance


@dataclass(frozen=True)
class LinkTorsion(Effect):
    """Twist = L/GJ times the moment about the link's own axis, one 1/GJ per link.

    That axis runs from its joint to the next or, with offset, to the far end of the next joint's offset along its own axis: no
    table of figures says where on that axis its bearing is, at the elbow or at the wrist.
    """

    offset: bool = False

    id = "link-torsion"
    title = "link torsion"
    forms = {False: "to the next joint's axis", True: "to the end of the next joint's offset"}
    words = Words("torsion", "the link twists under what it carries", "stiffness GJ")
    place_word = "link"
    family = STRUCTURE
    needs = ("masses",)
    told_by = "put two markers on the link's end, abreast of each other, and watch them while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one torsional flexibility per elastic link."""
        largest = float(rated_torques(self.robot).max())
        return tuple(
            Parameter(self.id, f"link{beam.link + 1}", "1/GJ", "1/Nm2", SOFT_SD / largest, 0.0, SOFT_BOUND / largest,
                      meaning=f"torsion of link {beam.link + 1}", joint=beam.link + 1)
            for beam in self._beams
        )  # fmt: skip

    @cached_property
    def _beams(self) -> tuple[Span, ...]:
        return longer_spans(self.robot) if self.offset else spans(self.robot)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each link twisted."""
        link, bearing = ca.SX(still.link), ca.SX(still.bearing)
        for k, beam in enumerate(self._beams):
            u = beam.span / beam.length
            if self.offset:
                bearing[3:, beam.link] = p[k] * beam.length * u * ca.dot(u, state.bearing[3:, beam.link])
            else:
                link[3:, beam.link + 1] = p[k] * beam.length * u * ca.dot(u, state.link[3:, beam.link + 1])
        return replace(still, link=link, bearing=bearing)

    variable = end_moment


def longer_spans(robot: Robot) -> tuple[Span, ...]:
    """Return links as beams to the far end of the next joint's offset along its axis, if it has one, in their joints' frames."""
    dims, beams = nominal_dimensions(robot), list[Span]()
    for i in range(robot.n_joints):
        following = robot.next_joint(i + 1)
        if following is None or robot.joints[following].kind != "revolute":
            continue
        offset = robot.frames[following].slide
        if offset and abs(offset.value) >= SHORTEST:
            axis = ca.evalf(span(robot, dims, i) @ to_axis(FrameChain(), robot, dims, following).frame)
            if float(ca.norm_2(ca.cross(axis[:3, 3], axis[:3, 2]))) > PARALLEL:
                beams.append(Span(i, axis[:3, 3] + offset.value * axis[:3, 2]))
    return tuple(beams)
