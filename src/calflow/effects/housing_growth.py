"""Housing growth: thermal expansion of a joint's housing along its axis as the motor inside warms up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.link_bending import SHORTEST
from calflow.effects.warming import Warming
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

EXPANSION_SD, GROWTH_SD, BOUND = 1e-5, 1e-4, 50.0  # m/K, m after warm-up, and standard deviations


@dataclass(frozen=True)
class HousingGrowth(Warming):
    """Offset along a joint's axis + h (T - 20 degC), or + h (1 - exp(-t / constant)).

    A long offset is a link's length (see `thermal_growth`); along nearly parallel axes the offsets are indistinguishable.
    """

    id = "housing-growth"
    title = "growth of a joint's housing"
    words = Words(
        "growth of the housing", "the joint's housing grows along its axis as the motor in it warms up", "growth"
    )

    readable = {"m": (1e6, "µm"), "m/K": (1e6, "µm per °C")}

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where no joint has such an offset."""
        return "" if _offsets(robot) else "an offset along a joint's axis"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each housing's growth."""
        unit, sd = ("m", GROWTH_SD) if self.constant else ("m/K", EXPANSION_SD)
        return tuple(
            Parameter(self.id, f"joint{joint + 1}", "h", unit, sd, -BOUND * sd, BOUND * sd, joint=joint + 1,
                      meaning=f"growth of the housing of joint {joint + 1}")
            for joint in _offsets(self.robot)
        )  # fmt: skip

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the offsets lengthened."""
        warmth = self.warmth(row)
        if not warmth.nnz():
            return dims
        steps = ca.SX(dims.steps)
        for k, (_, step) in enumerate(_offsets(self.robot).items()):
            steps[step] = dims.steps[step] + p[k] * warmth
        return replace(dims, steps=steps)


def _offsets(robot: Robot) -> dict[int, int]:
    """Return the short, distinguishable offsets along revolute joints' axes: index of the step by index of the joint."""
    steps = {}
    for i, (joint, place) in enumerate(zip(robot.joints, robot.places, strict=True)):
        offset = joint.frame.slide
        if joint.kind == "revolute" and offset and place in offset.free and abs(offset.value) < SHORTEST:
            steps[i] = robot.step_index(i, offset.symbol)
    return steps
