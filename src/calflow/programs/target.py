"""Targets: where a program tells its robot to go, and where in the file each of their numbers stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calflow.deployment.conventions import Turn
from calflow.programs.configuration import Configuration

Maker = Literal["rapid", "krl", "fanuc", "urscript"]


@dataclass(frozen=True)
class Number:
    """A number of a program: the bytes [start, end) where it stands, its text there, and how much one of it is in SI."""

    start: int
    end: int
    text: str
    scale: float

    @property
    def written(self) -> float:
        """Its value as it is written."""
        return float(self.text)

    @property
    def value(self) -> float:
        """Its value in SI."""
        return self.written * self.scale


@dataclass(frozen=True)
class External:
    """The value of an external axis as it is written; unit is deg or mm where the program says it."""

    value: float
    unit: str = ""


@dataclass(frozen=True)
class Target:
    """A place to go to, with the numbers that state it.

    Where turn is None the numbers are joint readings; else x, y and z of the tool and the figures of its orientation, in a frame:
    a quaternion (w, x, y, z), angles about z, y and x in turn, angles about the fixed x, y and z, or a rotation vector.
    tools and frames name those with which the program goes there, as far as it says; near are the arm's readings that it says
    are close. external has the values of external axes by their numbers, as far as it gives them.
    """

    name: str
    line: int
    numbers: tuple[Number, ...]
    turn: Turn | None
    configuration: Configuration | None = None
    tools: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    near: tuple[float, ...] | None = None
    external: Mapping[int, External] = field(default_factory=dict)

    @property
    def values(self) -> np.ndarray:
        """The numbers in SI."""
        return np.array([number.value for number in self.numbers])


@dataclass(frozen=True)
class Left:
    """Something of a program that is left as it is, or that the correction cannot know of, and why."""

    name: str
    line: int
    reason: str


@dataclass(frozen=True, eq=False)
class Program:
    """A program that was read: its bytes, its targets in the order of the file, what is left alone, and the frames it states.

    tools and frames are transforms (4, 4) by name, in SI; a name that the program uses and does not state is not among them.
    """

    maker: Maker
    source: bytes
    targets: tuple[Target, ...]
    left: tuple[Left, ...] = ()
    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    frames: Mapping[str, np.ndarray] = field(default_factory=dict)
