"""Targets: where a program tells its robot to go, and where in the file each of their numbers stands.

Configurations: by which flags a program says which of several joint positions a target means, maker by maker.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from calflow.deployment.conventions import Turn, pose_matrix

NEAR_CHANGE = np.deg2rad(0.5)  # a joint as near as this to where a flag changes may have either
KRL_BITS = {"S": 3, "T": 6}  # of each that are known
UNASKED: tuple[Reason, ...] = ("tool or frame", "no move")  # of what is no target that a move of the program goes to


@dataclass(frozen=True)
class ArmPosture:
    """Joint readings (n_joints,) [rad] and how the arm stands.

    front: the wrist is before the first axis and not behind it; elbow: it is on the side of the lower arm where it is when that
    stands upright and the forearm points forward. None where the robot has no such arm.
    """

    readings: tuple[float, ...]
    front: bool | None
    elbow: bool | None


@dataclass(frozen=True)
class Flag:
    """A flag of a configuration: the bytes [start, end) where it stands and its text there."""

    start: int
    end: int
    text: str


@dataclass(frozen=True)
class Configuration(ABC):
    """The flags of a target, in the order of the file."""

    flags: tuple[Flag, ...]

    @property
    def marks(self) -> tuple[str, ...]:
        """What the flags say, mark by mark."""
        return tuple(flag.text for flag in self.flags)

    @abstractmethod
    def of(self, posture: ArmPosture) -> tuple[str | None, ...]:
        """Return what the marks of a posture are; None where it cannot be told."""

    def judged(self, strictly: bool) -> tuple[str, ...]:
        """Return the marks that must agree; not strictly: without those that some robots of the maker do not use."""
        return self.marks

    def agrees(self, posture: ArmPosture, margin: float = NEAR_CHANGE, strictly: bool = True) -> bool:
        """Return whether each mark is as it is at the posture, or with all joints a margin [rad] to either side."""
        around = [self.of(posture)]
        if margin:
            around += [
                self.of(replace(posture, readings=tuple(np.add(posture.readings, d)))) for d in (-margin, margin)
            ]
        return all(
            None in marks or mark in marks
            for mark, marks in zip(self.judged(strictly), zip(*around, strict=True), strict=False)
        )

    def changes(self, before: ArmPosture, after: ArmPosture) -> tuple[tuple[Flag, str], ...]:
        """Return the flags that are others after a correction than before it, each with its new text."""
        pairs = zip(self.flags, self.of(before), self.of(after), strict=True)
        return tuple((flag, new) for flag, old, new in pairs if new not in (None, old, flag.text) and old is not None)


@dataclass(frozen=True)
class RapidConfiguration(Configuration):
    """ABB's cf1, cf4 and cf6, quarter turns of joints 1, 4 and 6, and cfx (RAPID reference manual, data type confdata).

    cfx counts the arm's eight ways to stand: 4 where the wrist is behind axis 1, 2 where it is behind the lower arm, 1 where
    joint 5 is negative. Old programs have a 0 there whatever the posture.
    """

    def of(self, posture: ArmPosture) -> tuple[str | None, ...]:
        """Return cf1, cf4, cf6 and cfx."""
        if len(posture.readings) != 6:
            return (None,) * 4
        quarters = [str(math.floor(posture.readings[joint] / (np.pi / 2))) for joint in (0, 3, 5)]
        if posture.front is None or posture.elbow is None:
            return (*quarters, None)
        return (*quarters, str(4 * (not posture.front) + 2 * (not posture.elbow) + (posture.readings[4] < 0)))

    def judged(self, strictly: bool) -> tuple[str, ...]:
        """Return all, or those without cfx."""
        return self.marks if strictly else self.marks[:3]


@dataclass(frozen=True)
class FanucConfiguration(Configuration):
    """FANUC's CONFIG: wrist F(lip) or N, elbow U(p) or D(own), arm T (front) or B (back), turns of joints 1, 4 and 6.

    A wrist is not flipped where joint 5 is negative, as when the tool points down at J5 = -90 degrees.
    """

    def of(self, posture: ArmPosture) -> tuple[str | None, ...]:
        """Return the three letters and the three numbers of turns."""
        if len(posture.readings) != 6:
            return (None,) * 6
        turns = [str(math.floor((posture.readings[joint] + np.pi) / (2 * np.pi))) for joint in (0, 3, 5)]
        elbow = None if posture.elbow is None else "U" if posture.elbow else "D"
        front = None if posture.front is None else "T" if posture.front else "B"
        return ("N" if posture.readings[4] < 0 else "F", elbow, front, *turns)


@dataclass(frozen=True)
class KrlConfiguration(Configuration):
    """KUKA's S and T (KRL reference guide). named says which of the two each flag is.

    Of S, bit 0 is set overhead, bit 1 where the elbow is as usual, bit 2 where A5 is negative; of T, bit n where A(n + 1) is
    negative. Further bits stand for other things, and stay.
    """

    named: tuple[str, ...]

    @property
    def marks(self) -> tuple[str, ...]:
        """The bits that are known, of each flag from bit 0 on."""
        return tuple(str(_krl_value(flag) >> k & 1) for name, flag in self._pairs for k in range(KRL_BITS[name]))

    def of(self, posture: ArmPosture) -> tuple[str | None, ...]:
        """Return the bits of S and T."""
        if len(posture.readings) != 6:
            return (None,) * len(self.marks)
        signs = [reading < 0 for reading in posture.readings]
        stance = (None, None) if posture.front is None else (not posture.front, posture.elbow)
        bits = {"T": signs, "S": [*stance, signs[4]]}
        return tuple(None if bit is None else str(int(bit)) for name in self.named for bit in bits[name])

    def changes(self, before: ArmPosture, after: ArmPosture) -> tuple[tuple[Flag, str], ...]:
        """Return the flags of which bits change between two postures."""
        old, new, flags = iter(self.of(before)), iter(self.of(after)), []
        for name, flag in self._pairs:
            value = _krl_value(flag)
            for k in range(KRL_BITS[name]):
                if (bit := next(new)) != next(old) and bit is not None:
                    value = value & ~(1 << k) | int(bit) << k
            if value != _krl_value(flag):
                width = len(flag.text) - 3
                flags.append((flag, f"{flag.text[:2]}{value:0{width}b}'" if flag.text.startswith("'") else str(value)))
        return tuple(flags)

    @property
    def _pairs(self) -> tuple[tuple[str, Flag], ...]:
        return tuple(zip(self.named, self.flags, strict=True))


def _krl_value(flag: Flag) -> int:
    return int(flag.text[2:-1], 2) if flag.text.startswith("'") else int(flag.text)


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


@dataclass(frozen=True, eq=False)
class Computed:
    """A place that a program computes from a target: before @ target @ after, transforms (4, 4), and what it is called."""

    name: str
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Use:
    """Tool and frame with which a move goes to a target, None where the program does not say, and readings [rad] near it.

    flagged: the controller heeds the target's configuration. computed: the place where the move goes, where that is not the target.
    file and line are where it stands, span the bytes [start, end) of the target's name there, where another may take its place.
    """

    tool: str | None = None
    frame: str | None = None
    near: tuple[float, ...] | None = None
    flagged: bool = True
    computed: Computed | None = None
    file: str = ""
    line: int = 0
    span: tuple[int, int] | None = None


@dataclass(frozen=True)
class Declaration:
    """How a target is declared from the byte start to end: head, name, sign, value [start, end), tail; remark begins remarks."""

    start: int
    end: int
    head: str
    sign: str
    value: tuple[int, int]
    tail: str
    remark: str


@dataclass(frozen=True)
class Target:
    """A place to go to, with the numbers that state it.

    Where turn is None the numbers are joint readings; else x, y and z of the tool and the figures of its orientation, in a frame:
    a quaternion (w, x, y, z), angles about z, y and x in turn, angles about the fixed x, y and z, or a rotation vector.
    uses are the moves that go there, as far as the program says. external has the values of external axes by their numbers, as
    far as it gives them. declared is how another with the same value can be declared, where its name has no other value.
    """

    name: str
    line: int
    numbers: tuple[Number, ...]
    turn: Turn | None
    configuration: Configuration | None = None
    uses: tuple[Use, ...] = ()
    external: Mapping[int, External] = field(default_factory=dict)
    declared: Declaration | None = None

    @cached_property
    def values(self) -> np.ndarray:
        """The numbers in SI."""
        return np.array([number.value for number in self.numbers])

    @cached_property
    def pose(self) -> np.ndarray:
        """The transform (4, 4) that the numbers mean."""
        return pose_matrix(self.values, self.turn or "quaternion")

    @property
    def near(self) -> tuple[float, ...] | None:
        """The arm's readings that the program says are close."""
        return next((use.near for use in self.uses if use.near), None)

    @property
    def flagged(self) -> bool:
        """Whether the controller heeds its configuration."""
        return not self.uses or any(use.flagged for use in self.uses)


Reason = Literal[
    "computed", "shared", "relative", "changed on the way", "several tools or frames", "standing tool", "elsewhere", "never taught",
    "unknown tool or frame", "not read",
    "incomplete", "configuration", "out of reach", "singularity", "tool or frame", "no move",
]  # fmt: skip


@dataclass(frozen=True)
class Left:
    """Something of a program that is left as it is, or that the correction cannot know of, and why."""

    name: str
    line: int
    reason: Reason
    note: str


@dataclass(frozen=True, eq=False)
class Program:
    """A program that was read: its bytes, its targets in the order of the file, what is left alone, and the frames it knows.

    tools and frames are transforms (4, 4) by name, in SI, of all files of its project; a name that it uses and none states is not
    among them. file is its name in the project.
    """

    maker: Maker
    source: bytes
    targets: tuple[Target, ...]
    left: tuple[Left, ...] = ()
    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    frames: Mapping[str, np.ndarray] = field(default_factory=dict)
    file: str = ""
