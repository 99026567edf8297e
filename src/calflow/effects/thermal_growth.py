"""Thermal growth: links that expand as they warm up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.beam import beams
from calflow.effects.warming import Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Dimensions, Row, reach_of
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

EXPANSION_SD, GROWTH_SD = 2e-5, 2e-4  # 1/K, and share of the length after warm-up
BOUNDS = 10.0, 25.0  # standard deviations of each


@dataclass(frozen=True)
class ThermalGrowth(Warming):
    """Lengths times 1 + alpha (T - 20 degC), or 1 + e (1 - exp(-t / constant)): of all alike, or of each link and bar (apart)."""

    apart: bool = False

    id = "thermal-growth"
    title = "thermal growth"
    words = Words("thermal growth", "the links grow as the robot warms up", "growth")
    readable = {"1": (1e6, "µm/m")}
    place_word = "link"
    whole = "links"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth common to all links and of each link and bar, with temperature or with a grid of time constants."""
        together = super().variants(robot, data)
        return (*together, *(replace(growth, apart=True) for growth in together))

    @property
    def detail(self) -> str:
        """What it grows with, and whether one link or bar grows or all."""
        return f"alone, {super().detail}" if self.apart else super().detail

    @property
    def _figure(self) -> tuple[str, str, float, float, str]:
        """Symbol, unit, prior standard deviation, bound and meaning of a growth parameter."""
        if self.constant:
            return "e", "1", GROWTH_SD, BOUNDS[1] * GROWTH_SD, "growth when warm"
        return "alpha", "1/K", EXPANSION_SD, BOUNDS[0] * EXPANSION_SD, "thermal expansion"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the common expansion, or that of each link and bar."""
        symbol, unit, sd, bound, meaning = self._figure
        places = [("links", 0, meaning)]
        if self.apart:
            places = [(f"link{link + 1}", link + 1, f"{meaning}, link {link + 1}") for link in self._links]
            places += [(bar, 0, f"{meaning}, {bar}") for bar in self._bars]
        return tuple(
            Parameter(self.id, part, symbol + ending, unit, sd, -bound, bound, joint=joint, meaning=words)
            for part, joint, words in places for ending in self.symbols
        )  # fmt: skip

    @property
    def _links(self) -> tuple[int, ...]:
        """Indices of the links long enough to have an expansion of their own."""
        return tuple(beam.link for beam in beams(self.robot))

    @property
    def _bars(self) -> tuple[str, ...]:
        """The loop's bars that have an expansion of their own: in free air, they stay colder than a link full of motors."""
        return ("crank", "rod") if self.robot.loop else ()

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the links lengthened."""
        growth = self.warmth(p, row)
        if not growth.nnz():
            return dims
        if self.apart:
            for k, link in enumerate(self._links):
                dims = _grown(dims, _lengths(self.robot, link), 1 + growth[k])
            bars = ca.SX(dims.bars)
            for k in range(len(self._bars)):
                bars[k] *= 1 + growth[len(self._links) + k]
            return replace(dims, bars=bars)
        return grown(self.robot, dims, 1 + growth)


def grown(robot: Robot, dims: Dimensions, growth: ca.SX) -> Dimensions:
    """Return the dimensions with all lengths multiplied by a growth factor."""
    every = [k for k, step in enumerate(robot.steps) if step.is_length]
    return replace(_grown(dims, every, growth), bars=dims.bars * growth)


def _lengths(robot: Robot, link: int) -> list[int]:
    """Return the indices of the steps that are a link's lengths, from its joint's axis to the next joint's."""
    steps = [(link, step) for step in robot.frames[link].body]
    following = robot.next_joint(link + 1)
    if following is not None:
        steps += [(following, step) for step in reach_of(robot, following)]
    return [robot.step_index(joint, step.symbol) for joint, step in steps if step.is_length]


def _grown(dims: Dimensions, lengths: Iterable[int], growth: ca.SX) -> Dimensions:
    steps = ca.SX(dims.steps)
    for k in lengths:
        steps[k] = dims.steps[k] * growth
    return replace(dims, steps=steps)
