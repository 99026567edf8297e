"""Tool deflection: a tool or flange that deflects, and rotates, under the payload's weight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_TOOL, Effect, Words, payload_variable
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

GIVES_SD, GIVES_BOUND = 3e-7, 1e-5  # m/N
TURNS_SD, TURNS_BOUND = 1e-6, 4e-5  # rad/N
TILT_SD, TILT_BOUND = 2e-3, 20e-3  # rad at the largest moment of a payload about its flange
USUAL = 1e3  # N: typical weight of a payload of unknown mass

TOOL = "tool"  # the part that carries all markers and deflects under payloads of known mass
Shape = Literal["alike", "adapter", "bracket", "direction"]
ENTRIES = tuple(i if i == j else i + j for j in "xyz" for i in "xyz")  # of a matrix, column by column
# Symbols of the shapes that give way, and turn, by the weight; or tilt, about the flange's axes by the moments about them.
GIVES: dict[Shape, tuple[str, ...]] = {
    "alike": ("c",),
    "bracket": ("c",),
    "direction": tuple(f"c{ij}" for ij in ENTRIES),
}
TURNS: dict[Shape, tuple[str, ...]] = {"bracket": ("t",), "direction": tuple(f"t{ij}" for ij in ENTRIES)}
TILTS: dict[Shape, tuple[str, ...]] = {"adapter": ("mx", "my", "mz")}


def tools(robot: Robot) -> dict[str, int]:
    """Return the number of the link of each tip's tool, by part; with several tips, parts are named after their links."""
    several = len(robot.tools) > 1
    return {f"{TOOL} {robot.links[link]}" if several else TOOL: link for link in robot.tools}


def markers_alone(robot: Robot) -> dict[str, int]:
    """Return the index of each marker on a tool that has several, by part."""
    on, there = robot.marker_links, tools(robot)
    names = {name: k for k, name in enumerate(robot.markers) if on[k] in robot.tools and on.count(on[k]) > 1}
    return {f"{name} (marker)" if name in there else name: k for name, k in names.items()}


def reach(robot: Robot) -> float:
    """Return the distance [m] of the farthest marker from its flange; a rotation about the flange moves no marker farther."""
    points = [
        marker.point
        for marker, link in zip(robot.markers.values(), robot.marker_links, strict=True)
        if link in robot.tools
    ]
    return max((float(np.linalg.norm(point)) for point in points), default=0.0)


def largest_moment(robot: Robot) -> float:
    """Return the largest moment [Nm] of a payload of known mass about the flange; 0 if no payload has a lever."""
    levers = [load.mass * float(np.linalg.norm(load.com)) for load in robot.payloads.values() if load.mass]
    return float(np.linalg.norm(robot.gravity)) * max(levers, default=0.0)


@dataclass(frozen=True)
class ToolDeflection(Effect):
    """Displacement = C · payload's weight F in the flange's frame, C isotropic, or a full matrix with a rotation T · F.

    A bracket along the flange's z deflects across it alone and rotates by t |F| about z x F: for a cantilever of length L,
    t = 1.5 c/L (Euler-Bernoulli), so that markers farther out move farther. In a slanted or crooked bracket a force along one
    axis displaces along another, which the full matrices describe for any shape. A payload of unknown mass is a part of
    its own, whose parameters are these compliances times its weight. A thin adapter or flange rotates instead, by a compliance
    times the moment of the payload about it: of payloads with centres at different distances, no matrix of weights says that.
    """

    shape: Shape = "alike"

    id = "tool-deflection"
    title = "tool deflection"
    forms = {
        "alike": "alike in all directions",
        "adapter": "an adapter that tilts under the payload's moment",
        "bracket": "a bracket along the flange's axis, which turns",
        "direction": "by direction, which turns",
    }
    words = Words("deflection of the tool", "the tool or its flange deflects under the payload", "deflection")
    readable = {"m/N": (9.80665e6, "µm/kg")}
    whole = TOOL
    family = OF_THE_TOOL
    needs = ("payload",)
    told_by = "put a marker on the flange beside those on the tool"

    @property
    def _unknown(self) -> dict[str, int]:
        """The indices, by part, of the payloads of unknown mass among all payloads."""
        on = self.robot.payload_links
        return {f"payload {name}": k for name, k in self.robot.unweighed.items() if on[k] in self.robot.tools}

    @property
    def _known(self) -> dict[str, int]:
        """The link numbers, by part, of the tools that carry payloads of known mass; all tools where there is no payload."""
        loads = zip(self.robot.payloads.values(), self.robot.payload_links, strict=True)
        loaded = [link for load, link in loads if load.mass or not self._unknown]
        every = {part: link for part, link in tools(self.robot).items() if link in loaded}
        return every or ({} if self._unknown else tools(self.robot))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliances under known weights, and the displacements under each unknown one."""
        parameters = [parameter for part in self._known for parameter in self._declare(part, "/N", 1.0)]
        return (*parameters, *(parameter for part in self._unknown for parameter in self._declare(part, "", USUAL)))

    def _declare(self, part: str, per: str, usual: float) -> Iterator[Parameter]:
        words = f"the tool's give under {part}" if part in self._unknown else f"the {part}'s give"
        lowest = 0.0 if self.shape == "bracket" else -1.0
        for symbol in GIVES.get(self.shape, ()):
            sd, bound = GIVES_SD * usual, GIVES_BOUND * usual
            yield Parameter(self.id, part, symbol, f"m{per}", sd, lowest * bound, bound, meaning=words)
        for symbol in TURNS.get(self.shape, ()):
            sd, bound = TURNS_SD * usual, TURNS_BOUND * usual
            yield Parameter(self.id, part, symbol, f"rad{per}", sd, lowest * bound, bound, meaning=f"{words}, its turn")
        # Nobody knows the moment of a payload of unknown mass or centre.
        if part in self._known and (largest := largest_moment(self.robot)):
            for symbol in TILTS.get(self.shape, ()):
                sd, bound = TILT_SD / largest, TILT_BOUND / largest
                yield Parameter(self.id, part, symbol, "rad/Nm", sd, 0.0, bound, meaning=f"{words}, its tilt")

    def size(self, p: ca.SX, own: Sequence[Parameter]) -> ca.SX:
        """Return the shift per weight: of a bracket, which may rotate alone, that of the farthest marker."""
        return p[0] + reach(self.robot) * p[1] if self.shape == "bracket" else super().size(p, own)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Return the deflection with each flange displaced."""
        link, parts_known, robot = ca.SX(still.link), self._known, self.robot
        for part, values in self.parts.items():
            load = self._unknown.get(part)
            on = parts_known[part] if load is None else robot.payload_links[load]
            weight = state.link[:3, on] if load is None else row.payload[load] * state.down[:, robot.tools.index(on)]
            link[:, on] += self._twist(p[values], weight, state.link[3:, on])
        return replace(still, link=link)

    def _twist(self, p: ca.SX, weight: ca.SX, moment: ca.SX) -> ca.SX:
        """Return the flange's twist (6,) by one part's parameters under a weight (3,), and the known payloads' moment (3,)."""
        x, y = weight[0], weight[1]
        if self.shape == "adapter":
            return ca.vertcat(ca.SX(3, 1), p * moment)
        if self.shape == "alike":
            return ca.vertcat(p[0] * weight, ca.SX(3, 1))
        if self.shape == "bracket":
            return ca.vertcat(p[0] * x, p[0] * y, 0, -p[1] * y, p[1] * x, 0)
        return ca.vertcat(ca.reshape(p[:9], 3, 3) @ weight, ca.reshape(p[9:], 3, 3) @ weight)

    variable = payload_variable
