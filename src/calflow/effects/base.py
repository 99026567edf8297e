"""What every effect is: one physical cause, its parameters, and the places where it may act."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from calflow.conditions import Row
from calflow.robot.chain import Deflection
from calflow.robot.description import Robot
from calflow.robot.dimensions import Dimensions, Loads
from calflow.robot.statics import State


@dataclass(frozen=True)
class Parameter:
    """A bounded decision variable (SI units); at its nominal value the effect is absent.

    The prior is normal about the nominal value with standard deviation prior_sd, cut at the bounds. figure is the
    maker's figure that the parameter's value is added to, for tables that show the sum; meaning says in words what it is.
    """

    effect: str
    part: str
    symbol: str
    unit: str
    prior_sd: float
    lower: float
    upper: float
    nominal: float = 0.0
    figure: float = 0.0
    meaning: str = ""

    @property
    def name(self) -> str:
        """The name that tables show, e.g. `joint2.alpha`."""
        return f"{self.part}.{self.symbol}"


@dataclass(frozen=True)
class Effect(ABC):
    """One physical cause. A subclass declares its parameters and overrides the one place where it acts.

    p is the column of this effect's parameters in the order declared; every default below means "does not act here".
    """

    robot: Robot

    id: ClassVar[str]
    title: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()  # what it cannot do without: columns of the data, or "masses"

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters for this robot."""

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Change lengths and angles."""
        return dims

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Change masses."""
        return loads

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX | float:
        """Add torques to the driven joints, (n_joints,) [Nm]."""
        return 0.0

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Move joints, bearings or link ends; still is no motion, to be replaced in part."""
        return still

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Change the position that the measuring device reports, (3,) [m]."""
        return point
