"""Link bending: links that bend like cantilevers from one joint's axis to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from calflow.effects.base import Effect, Variable, Words
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.links import span
from calflow.robot.parameter import Parameter
from calflow.robot.robot import Robot
from calflow.robot.statics import State, rated_torques

SOFT_SD, SOFT_BOUND = 2e-3, 40e-3  # rad of slope per metre at the largest rated torque
SHORTEST = 0.2  # m: stubs do not bend


@dataclass(frozen=True)
class Span:
    """A link (its index) as a beam: span (3,) [m] leads from its joint's axis to its far end, in that end's axes."""

    link: int
    span: ca.DM

    @property
    def length(self) -> float:
        """Distance of the axes [m]."""
        return float(ca.norm_2(self.span))


def spans(robot: Robot) -> tuple[Span, ...]:
    """Return the links that are long enough to give way."""
    dims = nominal_dimensions(robot)
    ends = [ca.evalf(span(robot, dims, i)) for i in range(robot.n_joints)]
    beams = (Span(i, end[:3, :3].T @ end[:3, 3]) for i, end in enumerate(ends))
    return tuple(beam for beam in beams if beam.length >= SHORTEST)


@dataclass(frozen=True)
class LinkBending(Effect):
    """Deflection and slope of a cantilever's tip under the force and moment there (Euler-Bernoulli), 1/EI a link.

    Slope = L²/2EI · u x F + L/EI · M, deflection = L³/3EI · F + L²/2EI · M x u for the parts of F and M across the
    link's direction u.
    """

    id: ClassVar[str] = "link-bending"
    title: ClassVar[str] = "link bending"
    words: ClassVar[Words] = Words("bending", "the link bends under what it carries", "stiffness EI")
    place_word: ClassVar[str] = "link"
    needs: ClassVar[tuple[str, ...]] = ("masses",)
    told_by: ClassVar[str] = "put markers on both ends of the link, and watch them while the load changes"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return one flexibility a long link."""
        largest = float(rated_torques(self.robot).max())
        return tuple(
            Parameter(self.id, f"link{span.link + 1}", "1/EI", "1/Nm2", SOFT_SD / largest, 0.0, SOFT_BOUND / largest,
                      meaning=f"bending of link {span.link + 1}", joint=span.link + 1)
            for span in spans(self.robot)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Move each link's far end."""
        link = ca.SX(still.link)
        for k, beam in enumerate(spans(self.robot)):
            force, moment = state.link[:3, beam.link + 1], state.link[3:, beam.link + 1]
            u, length = beam.span / beam.length, beam.length
            across, bends = force - u * ca.dot(u, force), moment - u * ca.dot(u, moment)
            slope = p[k] * (length**2 / 2 * ca.cross(u, force) + length * bends)
            shift = p[k] * (length**3 / 3 * across + length**2 / 2 * ca.cross(bends, u))
            link[:, beam.link + 1] = ca.vertcat(shift, slope)
        return replace(still, link=link)

    def variable(self, joint: int) -> Variable:
        """Return the moment at the link's end."""
        return Variable(f"moment at the end of link {joint}", "Nm", lambda state, row: ca.norm_2(state.link[3:, joint]))
