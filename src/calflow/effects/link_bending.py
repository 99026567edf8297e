"""Link bending: links that bend as cantilevers from one joint's axis to the next, straight or oblique."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from calflow.effects.base import STRUCTURE, Effect, Variable, Words
from calflow.robot.mechanism import Deflection, Row, State, nominal_dimensions, rated_torques, span
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SOFT_SD, SOFT_BOUND = 2e-3, 40e-3  # rad of slope per metre at the largest rated torque
SHORTEST = 0.2  # m: shorter links count as rigid
# Pairs of axes, in the order of the symbols of an oblique link's curvatures.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
CROSSED = ("cxy", "cxz", "cyz")
SYMBOLS = {"": ("1/EI",), "twisting": ("1/EI", "1/GJ"), "oblique": ("cxx", "cyy", "czz", *CROSSED)}


@dataclass(frozen=True)
class Span:
    """A link (by index) as a beam: span (3,) [m] is the vector from its joint's axis to its far end, in the end's frame."""

    link: int
    span: ca.DM

    @property
    def length(self) -> float:
        """Length of the beam [m]."""
        return float(ca.norm_2(self.span))


def spans(robot: Robot) -> tuple[Span, ...]:
    """Return the links that are long enough to count as elastic, as beams."""
    dims = nominal_dimensions(robot)
    ends = [ca.evalf(span(robot, dims, i)) for i in range(robot.n_joints)]
    beams = (Span(i, end[:3, :3].T @ end[:3, 3]) for i, end in enumerate(ends))
    return tuple(beam for beam in beams if beam.length >= SHORTEST)


def end_moment(effect: Effect, joint: int) -> Variable:
    """Return the moment at the end of a link (from 1) as the abscissa of its error."""
    return Variable(f"moment at the end of link {joint}", "Nm", lambda state, row: ca.norm_2(state.link[3:, joint]))


def bent(beam: Span, soft: ca.SX, force: ca.SX, moment: ca.SX) -> ca.SX:
    """Return the twist (6,) of a beam's far end under force and moment there, all in that end's frame (Euler-Bernoulli).

    soft (3, 3) [1/Nm²] is the curvature per moment, uniform along the beam. Each section bends under the end's moment plus the
    force times its moment arm, and displaces the end by its rotation times the same arm; both are integrated in closed form.
    """
    lever = ca.cross(ca.SX(beam.span), force)
    turn = beam.length * (soft @ (moment + lever / 2))
    shift = beam.length * ca.cross(soft @ (moment / 2 + lever / 3), ca.SX(beam.span))
    return ca.vertcat(shift, turn)


@dataclass(frozen=True)
class LinkBending(Effect):
    """turn = L C (M + r x F / 2), shift = L C (M / 2 + r x F / 3) x r: a cantilever under force F and moment M at its end.

    r, of length L, is the vector from its joint's axis to the next one's; C, the curvature per moment, is 1/EI across r, and
    1/GJ along it for a link that twists too. An oblique link, with skew principal axes or not along that line, has a
    symmetric C in the frame of its end instead: bending in two planes and torsion are coupled.
    """

    section: Literal["", "twisting", "oblique"] = ""

    id = "link-bending"
    title = "link bending"
    forms = {"": "straight", "twisting": "straight, and twists", "oblique": "oblique"}
    words = Words("bending", "the link bends under what it carries", "stiffness EI")
    place_word = "link"
    family = STRUCTURE
    needs = ("masses",)
    told_by = "put markers on both ends of the link, and watch them while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one flexibility per elastic link, or the entries of its curvature matrix."""
        largest = float(rated_torques(self.robot).max())
        sd, bound = SOFT_SD / largest, SOFT_BOUND / largest
        return tuple(
            Parameter(self.id, f"link{span.link + 1}", symbol, "1/Nm2", sd, -bound if symbol in CROSSED else 0.0, bound,
                      meaning=f"bending of link {span.link + 1}", joint=span.link + 1)
            for span in spans(self.robot) for symbol in SYMBOLS[self.section]
        )  # fmt: skip

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the flexibility in bending; torsion is not part of the size."""
        return super().size(p, own) if self.section == "oblique" else p[0]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each link's far end displaced."""
        link = ca.SX(still.link)
        each = len(SYMBOLS[self.section])
        for beam, compliances in zip(spans(self.robot), ca.vertsplit(p, each), strict=True):
            force, moment = state.link[:3, beam.link + 1], state.link[3:, beam.link + 1]
            link[:, beam.link + 1] = bent(beam, self._soft(beam, compliances), force, moment)
        return replace(still, link=link)

    def _soft(self, beam: Span, p: ca.SX) -> ca.SX:
        """Return a link's curvature per moment, C (3, 3) [1/Nm²]."""
        if self.section != "oblique":
            along = beam.span @ beam.span.T / beam.length**2
            return p[0] * (ca.DM.eye(3) - along) + (p[1] * along if self.section == "twisting" else 0)
        soft = ca.SX(3, 3)
        for k, (a, b) in enumerate(PAIRS):
            soft[a, b] = soft[b, a] = p[k]
        return soft

    variable = end_moment
