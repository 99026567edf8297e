"""The parts of a robot, in SI: joints with their links, the loop's bars, loads, markers, base and couplings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from calflow.robot.frames import Frame

Vector = tuple[float, float, float]
STANDARD_GRAVITY: Vector = (0.0, 0.0, -9.80665)  # m/s²
Thing = TypeVar("Thing")


class Named(Mapping[str, Thing], Generic[Thing]):
    """Things by name, in an order that counts; they cannot be changed."""

    def __init__(self, things: Mapping[str, Thing] | Iterable[tuple[str, Thing]] = ()) -> None:
        self._things = dict(things)

    def __getitem__(self, name: str) -> Thing:
        return self._things[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._things)

    def __len__(self) -> int:
        return len(self._things)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mapping) and list(self.items()) == list(other.items())

    def __hash__(self) -> int:
        return hash(tuple(self.items()))

    def __repr__(self) -> str:
        return repr(self._things)


@dataclass(frozen=True)
class Part:
    """Base of the parts: sequences and NumPy's numbers become tuples and Python's own, so that parts can be compared."""

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, plain(getattr(self, field.name)))


@dataclass(frozen=True)
class Joint(Part):
    """One joint and the link that it moves.

    limits are of the joint's own variable, after sign and couplings [rad, or m for a prismatic joint], rated_torque [Nm, or
    N], mass [kg] and com [m] in the link's frame; a reading counts sign times. A joint that is not driven has no reading: it
    follows others, as couplings say. external is the number of the controller's external axis (a rail, a turntable) that it
    is: it stays where it is commanded, and corrections move the arm alone.
    """

    frame: Frame
    kind: Literal["revolute", "prismatic"] = "revolute"
    limits: tuple[float, float] | None = None
    sign: Literal[1, -1] = 1
    gear_ratio: float | None = None
    rated_torque: float | None = None
    mass: float | None = None
    com: Vector = (0.0, 0.0, 0.0)
    name: str = ""
    driven: bool = True
    external: int | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad, or m for a prismatic joint]; a full turn where none is given."""
        return self.limits or (-np.pi, np.pi)

    @property
    def unit(self) -> Literal["rad", "m"]:
        """The unit of the joint's variable and of its errors."""
        return "rad" if self.kind == "revolute" else "m"

    @property
    def load_unit(self) -> Literal["Nm", "N"]:
        """The unit of what drives it."""
        return "Nm" if self.kind == "revolute" else "N"

    @property
    def shown(self) -> tuple[Literal["deg", "mm"], float]:
        """The unit in which people read the joint's variable, and how many of it are one rad or m."""
        return ("deg", float(np.rad2deg(1.0))) if self.kind == "revolute" else ("mm", 1e3)

    @property
    def noun(self) -> Literal["angle", "position"]:
        """What the joint's variable is."""
        return "angle" if self.kind == "revolute" else "position"


@dataclass(frozen=True)
class Bar(Part):
    """A moving bar of the loop: its length [m], and mass [kg] and centre along it and across it [m]."""

    length: float
    mass: float | None = None
    com: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class FourBar(Part):
    """A four-bar loop PQRS that drives a joint (counted from 1) from a motor on the joint before it; m and rad.

    P lies on the axis of the joint before, S on the driven joint's axis. The crank PQ turns with the motor, the rod QR
    pushes the rocker RS, which is part of the driven link. Angles are measured in the plane across the two axes.
    """

    joint: int
    crank: Bar
    rod: Bar
    rocker: float
    offset: float = 0.0
    assembly: Literal["open", "crossed"] = "open"


@dataclass(frozen=True)
class Payload(Part):
    """A named load on the flange [kg]; its centre in the flange's frame [m]. None: nobody knows its mass."""

    mass: float | None
    com: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Marker(Part):
    """A measured point of the tool, in the flange's frame [m].

    relative_sd [m] is how surely its place beside the first marker is known, where the tool was measured by itself. Not known: it
    may be anywhere, and the training poses say where.
    """

    point: Vector
    relative_sd: float | None = None
    known: bool = True


@dataclass(frozen=True)
class Base(Part):
    """Where the robot's base stands in the measuring device's frame [m and rad, about x, y and z in turn].

    fixed says that it is the measuring frame itself, since nothing looks at the robot from outside: then it has no errors.
    """

    origin: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    known: bool = True
    fixed: bool = False


@dataclass(frozen=True)
class Expected(Part):
    """What is stated of a parameter before this robot is measured, in SI: None is left as its effect has it.

    The parameter goes by its name, or by effect, part and symbol, as tables of parameters have them (of effects without
    variants). mean and sd are its prior's, as from other robots of the type, lower and upper its bounds; a fixed one is held
    at value, and at nominal where that is None.
    """

    effect: str = ""
    part: str = ""
    symbol: str = ""
    unit: str = ""
    mean: float | None = None
    sd: float | None = None
    name: str = ""
    lower: float | None = None
    upper: float | None = None
    fixed: bool = False
    value: float | None = None

    @property
    def key(self) -> str | tuple[str, str, str, str]:
        """What the parameter is known by: its name, or its identity."""
        return self.name or (self.effect, "", self.part, self.symbol)


@dataclass(frozen=True)
class Coupling(Part):
    """A joint reading that moves another joint too: q[joint] += factor * reading[source]; joints count from 1."""

    joint: int
    source: int
    factor: float


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a part holds them."""
    x, y, z = map(float, values)
    return x, y, z


def plain(value: Any) -> Any:
    """Return a value with its sequences as tuples and NumPy's numbers as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(map(plain, value))
    return value
