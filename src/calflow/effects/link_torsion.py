"""Link torsion: links that twist about their own axis."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.effects.base import Variable, Words
from calflow.effects.beam import Beam, ElasticLink, Softness
from calflow.robot.mechanism import Row, State


@dataclass(frozen=True)
class LinkTorsion(ElasticLink):
    """Twist = L/GJ times the moment about the link's own line, from its joint's axis to its far end; one 1/GJ per link.

    Its own weight twists it as far as its centre of mass.
    """

    id = "link-torsion"
    title = "link torsion"
    words = Words("torsion", "the link twists under what it carries", "stiffness GJ")
    told_by = "put two markers on the link's end, abreast of each other, and watch them while the load changes"
    flexibilities = {"1/GJ": 0.0}

    def soft(self, beam: Beam, p: ca.SX) -> Softness:
        """Return the curvature along the link's line, the same all along it."""
        along = p * (beam.line @ beam.line.T)
        return Softness(along, along)

    def variable(self, joint: int) -> Variable:
        """Return the moment about the link's line, to either side."""
        beam = self.beam(joint)

        def about(state: State, row: Row) -> ca.SX:
            return ca.fabs(ca.dot(beam.line, beam.load(state)[1]))

        return Variable(f"moment about the line of link {joint}", "Nm", about)
