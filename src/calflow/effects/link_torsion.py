"""Link torsion: links that twist about their own axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import STRUCTURE, Effect, Words
from calflow.effects.link_bending import SOFT_BOUND, SOFT_SD, end_moment, spans
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class LinkTorsion(Effect):
    """Twist = L/GJ times the moment about the link's own axis, one 1/GJ per link."""

    id = "link-torsion"
    title = "link torsion"
    words = Words("torsion", "the link twists under what it carries", "stiffness GJ")
    place_word = "link"
    family = STRUCTURE
    needs = ("masses",)
    told_by = "put two markers on the link's end, abreast of each other, and watch them while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one torsional flexibility per elastic link."""
        largest = float(rated_torques(self.robot).max())
        return tuple(
            Parameter(self.id, f"link{span.link + 1}", "1/GJ", "1/Nm2", SOFT_SD / largest, 0.0, SOFT_BOUND / largest,
                      meaning=f"torsion of link {span.link + 1}", joint=span.link + 1)
            for span in spans(self.robot)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each link twisted."""
        link = ca.SX(still.link)
        for k, beam in enumerate(spans(self.robot)):
            u = beam.span / beam.length
            link[3:, beam.link + 1] = p[k] * beam.length * u * ca.dot(u, state.link[3:, beam.link + 1])
        return replace(still, link=link)

    variable = end_moment
