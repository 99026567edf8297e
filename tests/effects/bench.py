"""Robots as calflow reads them and as the simulator knows them: what effects are compared on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from calflow.effects import Effect, catalogue
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, State, rated_torques
from calflow.robot.robot import Robot
from hidden import simulator
from hidden.causes import Hidden, measured_points, response
from hidden.simulator import Rows, equilibrium

BASE = ((3500.0, -500.0, -800.0), (0.4, -0.3, 165.0))  # mm and degrees: away from the measuring device
EVERYTHING = ("approach", "travel", "time", "temperature")
ROBOTS = ("serial", "hh800")
# The serial arm has no rail, no rod and no camera.
UNSHOWN = (
    "axis-straightness",
    "drive-stretch",
    "rod-play",
    *(name for name, effect in catalogue().items() if effect.imaged),
)
SESSIONS = ("mon", "tue", "wed", "fri")


@dataclass(frozen=True)
class Bench:
    """One robot as stated, read by calflow from its files, and as the simulator knows it, at some rows of its file."""

    robot: Robot
    data: Measurements
    real: simulator.Robot
    rows: Rows
    few: np.ndarray  # of the data's rows, those in rows
    still: simulator.State  # loads in the commanded poses

    @property
    def table(self) -> Measurements:
        """The rows that are compared."""
        return self.data.only(self.few)

    def points(self, *causes: Hidden, soft: bool = True) -> np.ndarray:
        """The simulator's points."""
        real = self.real if soft else replace(self.real, compliance=0 * self.real.compliance)
        return measured_points(real, self.rows, causes)

    def torque(self, joint: int, *causes: Hidden) -> np.ndarray:
        """The simulator's torque on a joint at equilibrium."""
        _, loads = equilibrium(self.real, self.rows, lambda s: response(self.real, self.rows, s, causes))
        return loads.torque[:, joint - 1]

    def rated(self, joint: int) -> float:
        """Rated torque of a joint."""
        return float(rated_torques(self.robot)[joint - 1])


def made(bench: Bench, name: str, **variant: Any) -> Effect:
    """An effect of the catalogue."""
    return catalogue()[name](bench.robot, **variant)


def waves(effect: Effect, joint: int, angle: np.ndarray) -> np.ndarray:
    """What each parameter of a joint's error adds to it at these angles (n_angles, n_parameters)."""
    loads = State.symbols(effect.robot)
    terms = effect.terms(joint - 1, loads, Row.symbols(effect.robot))
    values = ca.Function("terms", [loads.q], [ca.vertcat(*(term.value for term in terms))])
    q = np.zeros((effect.robot.n_joints, len(angle)))
    q[joint - 1] = angle
    return np.array(values(q)).T
