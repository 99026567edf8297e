"""Link bending: links that bend like cantilevers from one joint's axis to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from calflow.effects.base import Effect, Parameter, Variable
from calflow.robot.chain import Deflection
from calflow.robot.conditions import Row
from calflow.robot.description import Robot
from calflow.robot.dimensions import nominal_dimensions
from calflow.robot.statics import State, rated_torques
from calflow.robot.transforms import rot_x

SOFT_SD, SOFT_BOUND = 2e-3, 40e-3  # rad of slope per metre at the largest rated torque
SHORTEST = 0.2  # m: stubs do not bend


@dataclass(frozen=True)
class Span:
    """A link as a beam: from its joint's axis by the vector span (3,) [m] to its far end; link is its index."""

    link: int
    span: ca.DM

    @property
    def length(self) -> float:
        """Distance of the axes [m]."""
        return float(ca.norm_2(self.span))


def spans(robot: Robot) -> tuple[Span, ...]:
    """Return the links that are long enough to give way."""
    dims = nominal_dimensions(robot)
    found = []
    for i in range(robot.n_joints):
        if robot.convention == "modified-dh":  # the next axis is a_(i+1) further along x
            ahead = float(dims.a[i + 1]) if i + 1 < robot.n_joints else 0.0
            span = ca.DM([ahead, 0.0, float(dims.d[i])])
        else:
            span = ca.evalf(rot_x(dims.alpha[i])[:3, :3].T @ ca.vertcat(dims.a[i], 0, dims.d[i]))
        found.append(Span(i, span))
    return tuple(span for span in found if span.length >= SHORTEST)


@dataclass(frozen=True)
class LinkBending(Effect):
    """Deflection and slope of a cantilever's tip under the force and moment there (Euler-Bernoulli), 1/EI a link.

    Slope = L²/2EI · u x F + L/EI · M, deflection = L³/3EI · F + L²/2EI · M x u for the parts of F and M across the
    link's direction u.
    """

    id: ClassVar[str] = "link-bending"
    title: ClassVar[str] = "link bending"
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
