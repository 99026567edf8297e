"""Loaded transmission error: a gear's periodic error that grows with its torque or temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

from calflow.effects.base import TRANSMISSION, JointError, Term, Words, phases, unmet
from calflow.effects.warming import warmer
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot

ORDERS = (1, 2)  # per revolution of the joint, searched
MULTIPLES = 2  # per revolution of the motor, at most


@dataclass(frozen=True)
class LoadedTransmissionError(JointError):
    """dq = (A cos(order q) + B sin(order q)) · torque / rated, in addition to the unloaded transmission error.

    geared: the order is per revolution of the motor instead of the joint. warm: the amplitude is proportional to
    (T - 20 degC) / 10 K instead of torque / rated.
    """

    order: int = 1
    geared: bool = False
    warm: bool = False

    id = "loaded-transmission-error"
    title = "transmission error that grows with load or temperature"
    words = Words(
        "transmission error under load",
        "the angle is off as the joint turns, the more the larger its torque is or the warmer the gear",
        "amplitude at the rated torque, or 10 K above 20 degC",
    )
    family = TRANSMISSION
    side_by_side = True
    told_by = "move the joint alone over all its travel, with and without a load, and measure closely"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return the lowest orders, each growing with torque, temperature or either, as the data have them."""
        grows = [False] if not unmet(("torques",), robot, data.given) else []
        grows += [True] if data.temperature_changes else []
        orders = [(order, False) for order in ORDERS]
        orders += [(1, True)] if any(joint.gear_ratio for joint in robot.joints) else []
        return tuple(cls(robot, order, geared, warm) for warm in grows for order, geared in orders)

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where there are neither torques nor temperatures."""
        missing = unmet(("torques",), robot, data.given)
        return (
            f"{missing[0]}, or a column temperature_degC (that changes)"
            if missing and not data.temperature_changes
            else ""
        )

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the neighbouring orders, which are whole since the error repeats with each revolution."""
        orders = (self.order - 1, self.order + 1)
        return tuple(replace(self, order=k) for k in orders if k > 0 and not (self.geared and k > MULTIPLES))

    @property
    def detail(self) -> str:
        """The order, and what it grows with."""
        order = f"{self.order} a motor turn" if self.geared else f"order {self.order}"
        return f"{order}, by {'temperature' if self.warm else 'torque'}"

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the cosine and sine terms, each times the load."""
        ratio, of = 1.0, self.robot.joints[joint]
        if self.geared:
            ratio = of.gear_ratio or 0.0
        elif of.kind == "prismatic":
            ratio = 0.0
        if not ratio:
            return []
        sd = 1.5e-4 if self.geared else 3e-4
        waves = phases(self.order * ratio * state.q[joint], self.unit(joint), sd, 10e-3)
        load = warmer(row) if self.warm else self.load(joint, state)
        return [replace(wave, value=wave.value * load) for wave in waves]
