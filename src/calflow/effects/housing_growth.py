"""Housing growth: thermal expansion of a joint's housing, along its axis or turning its zero, as the motor inside warms up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.beam import SHORTEST
from calflow.effects.warming import Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

EXPANSION_SD, GROWTH_SD, BOUND = 1e-5, 1e-4, 50.0  # m or rad per K, m or rad after warm-up, and standard deviations


@dataclass(frozen=True)
class HousingGrowth(Warming):
    """Offset along a joint's axis + h (T - 20 degC), or + h (1 - exp(-t / constant)); with turning, the joint's zero instead.

    A long offset is a link's length (see `thermal_growth`); along nearly parallel axes the offsets are indistinguishable. A
    casting that is warmer on one side bends, and turns all that it carries.
    """

    turning: bool = False

    id = "housing-growth"
    title = "growth of a joint's housing"
    words = Words(
        "growth of the housing",
        "the joint's housing grows as the motor in it warms up, along its axis or unevenly",
        "growth",
    )

    readable = {"m": (1e6, "µm"), "m/K": (1e6, "µm per °C"), "rad/K": (1e6, "µrad per °C")}

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return growth along the axes where joints have such offsets, and that which turns the joints' zeros."""
        every = super().variants(robot, data)
        turning = tuple(replace(growth, turning=True) for growth in every)
        return tuple(growth for growth in (*every, *turning) if growth._steps)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where no joint turns."""
        return "" if _zeros(robot) else "a joint that turns"

    @property
    def detail(self) -> str:
        """What it grows with, and whether it turns the joint."""
        return f"turning its zero, {super().detail}" if self.turning else super().detail

    @property
    def _steps(self) -> Mapping[int, int]:
        """Indices of the steps that grow, by index of the joint."""
        return _zeros(self.robot) if self.turning else _offsets(self.robot)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each housing's growth."""
        unit = ("rad" if self.turning else "m") + ("" if self.constant else "/K")
        sd = GROWTH_SD if self.constant else EXPANSION_SD
        return tuple(
            Parameter(self.id, f"joint{joint + 1}", f"h{ending}", unit, sd, -BOUND * sd, BOUND * sd, joint=joint + 1,
                      meaning=f"growth of the housing of joint {joint + 1}")
            for joint in self._steps for ending in self.symbols
        )  # fmt: skip

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the offsets lengthened, or the zeros turned."""
        grown = self.warmth(p, row)
        if not grown.nnz():
            return dims
        steps = ca.SX(dims.steps)
        for k, step in enumerate(self._steps.values()):
            steps[step] = dims.steps[step] + grown[k]
        return replace(dims, steps=steps)


def _offsets(robot: Robot) -> dict[int, int]:
    """Return the short, distinguishable offsets along revolute joints' axes: index of the step by index of the joint."""
    steps = {}
    for i, (joint, place) in enumerate(zip(robot.joints, robot.places, strict=True)):
        offset = joint.frame.slide
        if joint.kind == "revolute" and offset and place in offset.free and abs(offset.value) < SHORTEST:
            steps[i] = robot.step_index(i, offset.symbol)
    return steps


def _zeros(robot: Robot) -> dict[int, int]:
    """Return the zeros of the joints that turn: index of the step by index of the joint."""
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    return {i: robot.step_index(i, robot.joints[i].frame.turn.symbol) for i in turning}
