"""Base tilt: base compliance of a robot whose link masses are unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words
from calflow.robot.frames import apply
from calflow.robot.mechanism import Deflection, Posture, Row, State, nominal_loads, nominal_posture
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

TILT_SD, TILT_BOUND = 1e-4, 5e-3  # rad under the arm's own largest moment
LIGHTER = 0.5  # assumed ratio of a link's mass to its predecessor's, where masses are unknown
LEAST = 0.1  # m: least length assumed of a link, whose centre of mass may lie off the axis

Shape = Literal["alike", "direction", "moments"]
COMPLIANCES: dict[Shape, tuple[str, ...]] = {
    "alike": ("c",),
    "direction": ("x", "y", "xy"),
    "moments": ("x", "y", "xy"),
}


class Arm(NamedTuple):
    """Assumed mass distribution of an arm: masses relative to the first link's, and link lengths [m].

    carried lists for each link those it carries, itself included; reach is the length of the longest chain [m].
    """

    masses: tuple[float, ...]
    lengths: tuple[float, ...]
    carried: tuple[tuple[int, ...], ...]
    reach: float

    @staticmethod
    def of(robot: Robot) -> Arm:
        """Return the mass distribution that the links' nominal lengths suggest."""
        at = nominal_posture(robot)
        spans = (end[:3, 3] - joint[:3, 3] for joint, end in zip(at.joints, at.ends[1:], strict=True))
        lengths = tuple(float(ca.DM(ca.evalf(ca.norm_2(span)))) for span in spans)
        chains = [robot.chain(link + 1) for link in range(robot.n_joints)]
        reach = max(sum(lengths[k] for k in chain) for chain in chains)
        return Arm(tuple(LIGHTER ** (len(chain) - 1) for chain in chains), lengths, robot.carried, reach)

    def first_moment(self, at: Posture[ca.SX]) -> ca.SX:
        """Return the sum of masses times centres in a posture, over the largest moment about the base, (3,)."""
        middles = [(joint[:3, 3] + end[:3, 3]) / 2 for joint, end in zip(at.joints, at.ends[1:], strict=True)]
        weighed = (mass * middle for mass, middle in zip(self.masses, middles, strict=True))
        return sum(weighed, ca.SX(3, 1)) / sum(self.moments)

    @property
    def moments(self) -> list[float]:
        """The first moment of each link, with all links it carries, about its own axis."""
        return [
            mass * max(length, LEAST) / 2 + (sum(self.masses[k] for k in carried[::-1]) - mass) * length
            for mass, length, carried in zip(self.masses, self.lengths, self.carried, strict=True)
        ]


@dataclass(frozen=True)
class BaseTilt(Effect):
    """Tilt of the base = C (mx, my), m the arm's overturning moment over its largest; C isotropic or symmetric.

    Moments are linear in the links' first moments, whatever the masses (Khalil and Dombre 2002). With shape "moments" each
    first moment has a C of its own; otherwise each link is assumed half as heavy as the one before, which reproduces the
    variation of real arms' moments over poses to a few per cent. Payloads of known mass tilt the base by a separate C, and each
    of unknown mass by one of its own: its weight times C, per metre of its moment arm, which its centre gives.
    """

    shape: Shape = "alike"

    id = "base-tilt"
    title = "base tilt (compliance of the foundation, masses unknown)"
    forms = {"alike": "alike in all directions", "direction": "by direction", "moments": "by direction, by link"}
    words = Words("tilt of the base", "the base or its foundation tilts under the robot's own weight", "tilt")
    needs = ("floor",)
    stands_in = "base-compliance"
    whole = "base"
    told_by = "watch a marker on the robot's foot while the arm reaches out"

    @cached_property
    def _arm(self) -> Arm:
        """The assumed mass distribution, with the links' nominal lengths."""
        return Arm.of(self.robot)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the tilts about the base's axes under the arm's largest moment, and the compliances under payloads."""
        words, one_sided, moments = "tilt of the base", ("c", "x", "y"), self._arm.moments
        of_arm = [("", 1.0, "the arm")]
        if self.shape == "moments":
            shares = enumerate((moment / sum(moments) for moment in moments), start=1)
            of_arm = [(f"_{k}{axis}", share, f"link {k}, along {axis}") for k, share in shares for axis in "xy"]
        forms = [
            Parameter(self.id, "base", f"t{symbol}{load}", "rad", TILT_SD * share,
                      0.0 if symbol in one_sided and not load else -TILT_BOUND, TILT_BOUND, meaning=f"{words} under {what}")
            for symbol in COMPLIANCES[self.shape] for load, share, what in of_arm
        ]  # fmt: skip
        of_payloads = [("", "rad/Nm", self._reach, "per moment of the payload")] if self._reach else []
        of_payloads += [(name, "rad/m", self._arm.reach, f"per arm of payload {name}") for name in self.robot.unweighed]
        forms += [
            Parameter(self.id, "base", f"p{symbol}{name and '_' + name}", unit, TILT_SD / arm,
                      0.0 if symbol in one_sided else -TILT_BOUND / arm, TILT_BOUND / arm, meaning=f"{words} {per}")
            for name, unit, arm, per in of_payloads for symbol in COMPLIANCES[self.shape]
        ]  # fmt: skip
        return tuple(forms)

    @property
    def _reach(self) -> float:
        """Moment [Nm] of the heaviest payload of known mass at the arm's full reach; 0 without any."""
        heaviest = max((load.mass or 0.0 for load in self.robot.payloads.values()), default=0.0)
        return heaviest * float(np.linalg.norm(self.robot.gravity)) * self._arm.reach

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the base tilted."""
        compliances, tilt, begin = COMPLIANCES[self.shape], ca.SX(2, 1), 0
        for arm in (self._moments(row), *self._payload_moments(row)):
            end = begin + arm.shape[1] * len(compliances)
            weighed = [arm @ share for share in ca.vertsplit(p[begin:end], arm.shape[1])]
            tilt, begin = tilt + _tilted(dict(zip(compliances, weighed, strict=True))), end
        link = ca.SX(still.link)
        link[3:5, 0] = tilt
        return replace(still, link=link)

    def _moments(self, row: Row) -> ca.SX:
        """Return the normalised overturning moments that the parameters multiply, shape (2, n)."""
        at, down, arm = nominal_posture(self.robot, row.q), ca.DM(self.robot.down), self._arm
        if self.shape == "moments":
            tilts = [ca.cross(frame[:3, axis], down)[:2] for frame in at.links for axis in (0, 1)]
            return ca.horzcat(*tilts)
        return ca.cross(arm.first_moment(at), down)[:2]

    def _payload_moments(self, row: Row) -> list[ca.SX]:
        """Return the overturning moment of the payloads of known mass [Nm], then the arm of each other one [m], (2, 1) each."""
        robot, at, loads = self.robot, nominal_posture(self.robot, row.q), nominal_loads(self.robot)
        arms = [
            row.payload[k]
            * ca.cross(apply(at.frame(robot, robot.payload_links[k]), loads.payload_com[:, k]), ca.DM(robot.down))[:2]
            for k in range(len(robot.payloads))
        ]
        gravity = float(np.linalg.norm(robot.gravity))
        known = sum((gravity * loads.payload_mass[k] * arm for k, arm in enumerate(arms)), ca.SX(2, 1))
        return [*([known] if self._reach else []), *(arms[k] for k in self.robot.unweighed.values())]

    def variable(self, joint: int) -> Variable:
        """Return the normalised overturning moment under the assumed mass distribution."""
        moments = BaseTilt(self.robot)._moments
        return Variable(
            "overturning moment of the arm over its largest", "", lambda state, row: ca.norm_2(moments(row))
        )


def _tilted(by: dict[str, ca.SX]) -> ca.SX:
    """Return the tilt about x and y, given the moment (2, 1) weighted by each entry of the compliance."""
    if "c" in by:
        return by["c"]
    return ca.vertcat(by["x"][0] + by["xy"][1], by["y"][1] + by["xy"][0])
