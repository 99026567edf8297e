"""Beams: links that give way from their joint's axis to their far end, base class of link bending and link torsion."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from calflow.effects.base import STRUCTURE, Effect, Variable
from calflow.robot.mechanism import (
    Deflection,
    FrameChain,
    Row,
    State,
    along,
    figures,
    nominal_dimensions,
    rated_torques,
    span,
    to_axis,
)  # fmt: skip
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SOFT_SD, SOFT_BOUND = 2e-3, 40e-3  # rad of slope per metre at the largest rated torque
SHORTEST = 0.2  # m: shorter links count as rigid
PARALLEL = 1e-6  # m beside the next joint's axis, within which a link that ends on it gives way as the next one does


@dataclass(frozen=True)
class Softness:
    """A beam's curvature per moment (3, 3) [1/Nm²] at its joint's axis and at its far end, and between them in proportion."""

    near: ca.SX
    far: ca.SX

    def until(self, share: float) -> Softness:
        """Return that of its first part, a share of its length."""
        return Softness(self.near, self.near + share * (self.far - self.near))


@dataclass(frozen=True)
class Beam:
    """A link (by index) as a beam: span (3,) [m] is the vector from its joint's axis to its far end.

    That lies beyond (3,) [m] from where the next joint's axis is, and its centre of mass (3,) [m] from its joint's axis; all in
    the frame of the link's end at the next joint's axis, to which axes (3, 3) turns vectors of its joint's.
    """

    link: int
    span: ca.DM
    beyond: ca.DM
    centre: ca.DM
    axes: ca.DM

    @property
    def length(self) -> float:
        """Length of the beam [m]."""
        return float(ca.norm_2(self.span))

    @property
    def line(self) -> ca.DM:
        """Direction of the beam (3,)."""
        return self.span / self.length

    def load(self, state: State) -> tuple[ca.SX, ca.SX]:
        """Return force and moment (3,) at its far end."""
        force, moment = state.link[:3, self.link + 1], state.link[3:, self.link + 1]
        return force, moment - ca.cross(ca.SX(self.beyond), force)

    def twist(self, soft: Softness, state: State) -> ca.SX:
        """Return the twist (6,) of the link's end under what it carries there and under its own weight.

        No file says how the weight is spread about its centre. Two thirds of it act there, and a third at the beam's ends as
        the law of the lever shares it: exact for a uniform beam (Simpson's rule). What lies behind the joint bends nothing.
        """
        (force, moment), i = self.load(state), self.link
        weight = self.axes @ state.bearing[:3, i] - state.link[:3, i + 1]  # its joint carries that as well
        share = min(max(float(ca.dot(self.centre, self.line)) / self.length, 0.0), 1.0)
        place = share * self.span
        to_centre = replace(self, span=place, beyond=self.beyond - (self.span - place))
        aside = ca.cross(ca.SX(self.centre - place), weight)
        at_end = self.bent(soft, force + share / 3 * weight, moment + share / 3 * aside)
        return at_end + 2 / 3 * to_centre.bent(soft.until(share), weight, aside)

    def bent(self, soft: Softness, force: ca.SX, moment: ca.SX) -> ca.SX:
        """Return the twist (6,) of the link's end under force and moment at the beam's (Euler-Bernoulli).

        Each section bends under the end's moment plus the force times its moment arm, and displaces the end by its rotation
        times the same arm; both are integrated in closed form.
        """
        lever, more = ca.cross(ca.SX(self.span), force), soft.far - soft.near
        turn = self.length * (soft.near @ (moment + lever / 2) + more @ (moment / 2 + lever / 6))
        curved = soft.near @ (moment / 2 + lever / 3) + more @ (moment / 6 + lever / 12)
        shift = self.length * ca.cross(curved, ca.SX(self.span))
        return ca.vertcat(shift + ca.cross(ca.SX(self.beyond), turn), turn)


def beams(robot: Robot, offset: bool = False) -> tuple[Beam, ...]:
    """Return the links that are long enough to count as elastic, as beams to the next joint's axis.

    With offset those whose next joint has an offset along its axis, as long, as beams to the far end of it.
    """
    dims, found = nominal_dimensions(robot), list[Beam]()
    for i in range(robot.n_joints):
        end = ca.evalf(span(robot, dims, i))
        axes = end[:3, :3].T
        link = along(FrameChain(), robot.frames[i].body, figures(robot, dims, i))
        centre = ca.evalf(link.carried(ca.SX(ca.DM(robot.joints[i].com))))
        beam = Beam(i, axes @ end[:3, 3], ca.DM(3, 1), axes @ centre, axes)
        following = robot.next_joint(i + 1)
        if offset and following is not None and robot.joints[following].kind == "revolute":
            slide = robot.frames[following].slide
            axis = ca.evalf(to_axis(FrameChain(), robot, dims, following).frame)
            aside = float(ca.norm_2(ca.cross(beam.span + axis[:3, 3], axis[:3, 2])))
            if slide and abs(slide.value) >= SHORTEST and aside > PARALLEL:
                beyond = axis[:3, 3] + slide.value * axis[:3, 2]
                found.append(replace(beam, span=beam.span + beyond, beyond=beyond))
        elif not offset and beam.length >= SHORTEST:
            found.append(beam)
    return tuple(found)


@dataclass(frozen=True)
class ElasticLink(Effect):
    """A link that gives way to the next joint's axis or, with offset, to the far end of that joint's offset along its axis.

    No table of figures says where on its axis a joint's bearing is: at the elbow, say, or at the wrist.
    """

    offset: bool = False

    forms = {False: "to the next joint's axis", True: "to the end of the next joint's offset"}
    place_word = "link"
    family = STRUCTURE
    needs = ("masses",)

    @cached_property
    def beams(self) -> tuple[Beam, ...]:
        """The links that give way."""
        return beams(self.robot, self.offset)

    @property
    @abstractmethod
    def flexibilities(self) -> dict[str, float]:
        """The symbols of each link's flexibilities [1/Nm²], and their lower bounds as shares of the upper ones."""

    @abstractmethod
    def soft(self, beam: Beam, p: ca.SX) -> Softness:
        """Return a link's curvature per moment from its own flexibilities."""

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the flexibilities of each elastic link."""
        largest = float(rated_torques(self.robot).max())
        sd, bound = SOFT_SD / largest, SOFT_BOUND / largest
        noun = self.in_words().name
        return tuple(
            Parameter(self.id, f"link{beam.link + 1}", symbol, "1/Nm2", sd, least * bound, bound,
                      meaning=f"{noun} of link {beam.link + 1}", joint=beam.link + 1)
            for beam in self.beams for symbol, least in self.flexibilities.items()
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each link's end displaced."""
        link = ca.SX(still.link)
        for beam, own in zip(self.beams, ca.vertsplit(p, len(self.flexibilities)), strict=True):
            link[:, beam.link + 1] = beam.twist(self.soft(beam, own), state)
        return replace(still, link=link)

    def beam(self, joint: int) -> Beam:
        """Return the link after a joint (from 1)."""
        return next(beam for beam in self.beams if beam.link == joint - 1)

    def variable(self, joint: int) -> Variable:
        """Return the moment at the link's end."""
        beam = self.beam(joint)
        return Variable(f"moment at the end of link {joint}", "Nm", lambda state, row: ca.norm_2(beam.load(state)[1]))
