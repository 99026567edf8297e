"""Link bending: links that bend as cantilevers from their joint's axis to their far end, straight or oblique."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.beam import Beam, ElasticLink, Softness
from calflow.measurements.measurements import Measurements
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

Section = Literal["", "tapered", "twisting", "oblique"]
# Pairs of axes, in the order of the symbols of an oblique link's curvatures.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
SECTIONS: dict[Section, str] = {
    "": "straight",
    "tapered": "straight, and tapers",
    "twisting": "straight, and twists",
    "oblique": "oblique",
}
SYMBOLS = {
    "": ("1/EI",),
    "tapered": ("1/EI_near", "1/EI_far"),
    "twisting": ("1/EI", "1/GJ"),
    "oblique": ("cxx", "cyy", "czz", "cxy", "cxz", "cyz"),
}
CROSSED = SYMBOLS["oblique"][3:]


@dataclass(frozen=True)
class LinkBending(ElasticLink):
    """turn = L C (M + r x F / 2), shift = L C (M / 2 + r x F / 3) x r: a cantilever under force F and moment M at its end.

    r, of length L, is the vector from its joint's axis to that end; C, the curvature per moment, is 1/EI across r, and 1/GJ
    along it for a link that twists too; of a tapered link 1/EI goes from one figure at the joint's axis to another at that end,
    and between them in proportion. An oblique link, with skew principal axes or not along that line, has a symmetric C in
    the frame of its end instead: bending in two planes and torsion are coupled. Its own weight is such a load too, shared
    between its centre of mass and its ends (see `Beam.twist`).
    """

    section: Section = ""

    id = "link-bending"
    title = "link bending"
    words = Words("bending", "the link bends under what it carries", "stiffness EI")
    told_by = "put markers on both ends of the link, and watch them while the load changes"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each section, of links to the next joint's axis and to the end of its offset."""
        return tuple(replace(link, section=section) for link in super().variants(robot, data) for section in SECTIONS)

    @property
    def detail(self) -> str:
        """The section in words, and how far the link goes where that is beyond the next joint's axis."""
        return f"{SECTIONS[self.section]}{self.offset * f', {super().detail}'}"

    @property
    def flexibilities(self) -> dict[str, float]:
        """The entries of a link's curvature per moment."""
        return {symbol: -1.0 if symbol in CROSSED else 0.0 for symbol in SYMBOLS[self.section]}

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the flexibility in bending, of a tapered link the mean; torsion is not part of the size."""
        if self.section == "tapered":
            return (p[0] + p[1]) / 2
        return super().size(p, own) if self.section == "oblique" else p[0]

    def soft(self, beam: Beam, p: ca.SX) -> Softness:
        """Return a link's curvature per moment."""
        if self.section == "oblique":
            uniform = ca.SX(3, 3)
            for k, (a, b) in enumerate(PAIRS):
                uniform[a, b] = uniform[b, a] = p[k]
            return Softness(uniform, uniform)
        along = beam.line @ beam.line.T
        across = ca.DM.eye(3) - along
        if self.section == "tapered":
            return Softness(p[0] * across, p[1] * across)
        uniform = p[0] * across + (p[1] * along if self.section == "twisting" else 0)
        return Softness(uniform, uniform)
