"""Base tilt: base compliance of a robot whose link masses are unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, Variable, Words
from calflow.robot.frames import apply
from calflow.robot.mechanism import Deflection, Posture, Row, State, nominal_dimensions, nominal_loads, pose
from calflow.robot.parts import Parameter

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
    """Assumed mass distribution of the arm: masses relative to the first link's, and link lengths [m].

    carried lists for each link those it carries, itself included; reach is the length of the longest chain [m].
    """

    masses: tuple[float, ...]
    lengths: tuple[float, ...]
    carried: tuple[tuple[int, ...], ...]
    reach: float

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
    variation of real arms' moments over poses to a few per cent. Payloads of known mass tilt the base by a separate C.
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
        robot = self.robot
        at = pose(robot, nominal_dimensions(robot), ca.SX.zeros(robot.n_joints), Deflection.zero(robot.n_joints))
        spans = (end[:3, 3] - joint[:3, 3] for joint, end in zip(at.joints, at.ends[1:], strict=True))
        lengths = tuple(float(ca.DM(ca.evalf(ca.norm_2(span)))) for span in spans)
        chains = [robot.chain(link + 1) for link in range(robot.n_joints)]
        reach = max(sum(lengths[k] for k in chain) for chain in chains)
        return Arm(tuple(LIGHTER ** (len(chain) - 1) for chain in chains), lengths, robot.carried, reach)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the tilts about the base's axes under the arm's largest moment, and the compliances under payloads."""
        forms, words = [], "tilt of the base"
        low = dict.fromkeys(("c", "x", "y"), 0.0)
        for symbol in COMPLIANCES[self.shape]:
            if self.shape != "moments":
                forms.append(self._tilt(f"t{symbol}", low.get(symbol, -TILT_BOUND), 1.0, f"{words} under the arm"))
                continue
            for k, moment in enumerate(self._arm.moments):
                share = moment / sum(self._arm.moments)
                forms += [
                    self._tilt(
                        f"t{symbol}_{k + 1}{axis}", -TILT_BOUND, share, f"{words} under link {k + 1}, along {axis}"
                    )
                    for axis in "xy"
                ]
        if self._reach:
            sd, bound = TILT_SD / self._reach, TILT_BOUND / self._reach
            forms += [
                Parameter(self.id, "base", f"p{symbol}", "rad/Nm", sd, 0.0 if symbol in low else -bound, bound,
                          meaning=f"{words} per moment of the payload")
                for symbol in COMPLIANCES[self.shape]
            ]  # fmt: skip
        return tuple(forms)

    def _tilt(self, symbol: str, lower: float, share: float, words: str) -> Parameter:
        return Parameter(self.id, "base", symbol, "rad", TILT_SD * share, lower, TILT_BOUND, meaning=words)

    @property
    def _reach(self) -> float:
        """Moment [Nm] of the heaviest payload of known mass at the arm's full reach; 0 without any."""
        heaviest = max((load.mass or 0.0 for load in self.robot.payloads.values()), default=0.0)
        return heaviest * float(np.linalg.norm(self.robot.gravity)) * self._arm.reach

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with the base tilted."""
        compliances = COMPLIANCES[self.shape]
        moments = self._moments(row)
        n_own = moments.shape[1] * len(compliances)
        tilt = ca.SX(2, 1)
        for of, arm in ((p[:n_own], moments), (p[n_own:], self._payload_moment(row) if p.numel() > n_own else None)):
            if arm is None:
                continue
            weighed = [arm @ share for share in ca.vertsplit(of, arm.shape[1])]
            tilt += _tilted(dict(zip(compliances, weighed, strict=True)))
        link = ca.SX(still.link)
        link[3:5, 0] = tilt
        return replace(still, link=link)

    def _moments(self, row: Row) -> ca.SX:
        """Return the normalised overturning moments that the parameters multiply, shape (2, n)."""
        at, down, arm = self._posture(row), ca.DM(self.robot.down), self._arm
        if self.shape == "moments":
            tilts = [ca.cross(frame[:3, axis], down)[:2] for frame in at.links for axis in (0, 1)]
            return ca.horzcat(*tilts)
        total = ca.SX(3, 1)
        for mass, joint, end in zip(arm.masses, at.joints, at.ends[1:], strict=True):
            total += mass * ca.cross((joint[:3, 3] + end[:3, 3]) / 2, down)
        return total[:2] / sum(arm.moments)

    def _payload_moment(self, row: Row) -> ca.SX:
        """Return the payload's overturning moment [Nm], shape (2, 1)."""
        at, loads = self._posture(row), nominal_loads(self.robot)
        total = ca.SX(3, 1)
        for k in range(len(self.robot.payloads)):
            weight = row.payload[k] * loads.payload_mass[k] * ca.DM(self.robot.gravity)
            link = at.frame(self.robot, self.robot.payload_links[k])
            total += ca.cross(apply(link, loads.payload_com[:, k]), weight)
        return total[:2]

    def _posture(self, row: Row) -> Posture[ca.SX]:
        n = self.robot.n_joints
        return pose(self.robot, nominal_dimensions(self.robot), row.q, Deflection.zero(n))

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
