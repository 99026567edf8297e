"""Joint errors: what all effects share that add something to single joint angles."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from calflow.effects.base import Effect, joint_variable
from calflow.robot.mechanism import Deflection, Row, State, rated_torques
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

TRANSMISSION = "angular transmission error"
REVERSALS = "vary the travel since the last reversal, from tenths of a degree (a slide: of a millimetre) to many"
JOINT_ALONE = "move the joint alone over all its travel, and measure closely on the way"


@dataclass(frozen=True)
class Term:
    """One parameter of a joint's error: dq = parameter · value; unit, prior_sd and bound are SI, so m for a slide."""

    symbol: str
    unit: str
    prior_sd: float
    bound: float
    value: ca.SX
    one_sided: bool = False


def phases(angle: ca.SX, unit: str, sd: float, bound: float) -> list[Term]:
    """Return cosine and sine of an angle, for a wave of any phase; sd and bound are in the joint's unit."""
    return [Term("cos", unit, sd, bound, ca.cos(angle)), Term("sin", unit, sd, bound, ca.sin(angle))]


@lru_cache(maxsize=16)
def _symbols(robot: Robot) -> tuple[State, Row]:
    """Symbols of which terms are made only to be asked for their names and sizes."""
    return State.symbols(robot), Row.symbols(robot)


@dataclass(frozen=True)
class JointError(Effect):
    """dq_i = sum of parameter · term, for every joint apart; a subclass says which terms."""

    @abstractmethod
    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return the terms of one joint (index from 0); none where it does not apply."""

    @cached_property
    def rated(self) -> np.ndarray:
        """Rated torques [Nm, a slide's N], shape (n_joints,)."""
        return rated_torques(self.robot)

    def load(self, joint: int, state: State) -> ca.SX:
        """Return a joint's torque (index from 0) over its rated one."""
        return state.torque[joint] / self.rated[joint]

    def unit(self, joint: int) -> str:
        """Return the unit of a joint's error (index from 0): m for a slide."""
        return self.robot.joints[joint].unit

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each joint's parameters."""
        state, row = _symbols(self.robot)
        return tuple(
            Parameter(self.id, f"joint{i + 1}", term.symbol, term.unit, term.prior_sd,
                      0.0 if term.one_sided else -term.bound, term.bound,
                      meaning=f"{self.title}, joint {i + 1}", joint=i + 1)
            for i in range(self.robot.n_joints) for term in self.terms(i, state, row)
        )  # fmt: skip

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn each joint by its terms."""
        turned = []
        for i, amplitudes in enumerate(ca.vertsplit(p, self._ends)):
            values = [term.value for term in self.terms(i, state, row)] if amplitudes.nnz() else []
            turned.append(ca.dot(amplitudes, ca.vertcat(*values)) if values else ca.SX(1, 1))
        return replace(still, joint=ca.vertcat(*turned))

    @cached_property
    def _ends(self) -> list[int]:
        """Where each joint's parameters begin and end among all."""
        counts = np.bincount([parameter.joint for parameter in self.declared], minlength=self.robot.n_joints + 1)
        return np.cumsum(counts).tolist()

    variable = joint_variable
