"""Targets: the poses and joint positions of a program, with the byte positions of their numbers in the file.

Configurations: the flags, maker by maker, that select one of several inverse-kinematics solutions of a target.
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

NEAR_CHANGE = np.deg2rad(0.5)  # distance from a flag's switching angle within which both values are accepted
MARGINS = NEAR_CHANGE / 2.0 ** np.arange(16, -1, -1)  # distances at which one that was taught there may be found
KRL_BITS = {"S": 3, "T": 6}  # number of bits with a known meaning
UNASKED: tuple[Reason, ...] = ("tool or frame", "no move")  # reasons of entries that no move uses


@dataclass(frozen=True)
class ArmPosture:
    """The arm's readings [rad] and its posture.

    front: whether the wrist is in front of the first axis; elbow: whether the elbow is up, as when the lower arm stands
    upright and the forearm points forward. None where the robot has no such arm.
    """

    readings: tuple[float, ...]
    front: bool | None
    elbow: bool | None


@dataclass(frozen=True)
class Flag:
    """A flag of a configuration: its bytes [start, end) in the file, and its text."""

    start: int
    end: int
    text: str


@dataclass(frozen=True)
class Configuration(ABC):
    """The flags of a target, in the order of the file."""

    flags: tuple[Flag, ...]

    @property
    def marks(self) -> tuple[str, ...]:
        """The values of the flags; of flags made of bits, the bits."""
        return tuple(flag.text for flag in self.flags)

    @abstractmethod
    def of(self, posture: ArmPosture) -> tuple[str | None, ...]:
        """Return the marks of a posture; None for each that is undetermined."""

    def judged(self, strictly: bool) -> tuple[str, ...]:
        """Return the marks that must agree; if not strictly, without those that some robots of the maker ignore."""
        return self.marks

    def agrees(self, posture: ArmPosture, margin: float = NEAR_CHANGE, strictly: bool = True) -> bool:
        """Return whether each mark agrees with the posture, or with it shifted by a margin [rad] either way."""
        around = self._around(posture, margin)
        return all(None in marks or mark in marks for mark, marks in zip(self.judged(strictly), around, strict=False))

    def _around(self, posture: ArmPosture, margin: float) -> list[tuple[str | None, ...]]:
        """Return of each mark the values at a posture, and at those a margin [rad] before and behind it."""
        shifted = (replace(posture, readings=tuple(np.add(posture.readings, d))) for d in (0.0, -margin, margin))
        return list(zip(*map(self.of, shifted), strict=True))

    def changes(self, before: ArmPosture, after: ArmPosture) -> tuple[tuple[Flag, str], ...]:
        """Return the flags that a correction changes, each with its new text."""
        return tuple((flag, new) for flag, new in zip(self.flags, self._new(before, after), strict=True) if new)

    def _new(self, before: ArmPosture, after: ArmPosture) -> list[str]:
        """Return the new value of each mark; empty: it stays.

        One changes if its boundary is crossed, or if it was taught on the boundary, where the file may have either value, and
        leaves it. A mark that says something else, as an unused one, stays.
        """
        new = []
        for k, (mark, was, now) in enumerate(zip(self.marks, self.of(before), self.of(after), strict=True)):
            known = was is not None and now is not None and mark != now
            new.append(now or "" if known and (was != now or self._left(k, mark, before, after)) else "")
        return new

    def _left(self, k: int, mark: str, before: ArmPosture, after: ArmPosture) -> bool:
        """Return whether a joint leaves the boundary at which a posture was taught on the other side of it than it is found."""
        found = next((margin for margin in MARGINS if mark in self._around(before, margin)[k]), None)
        return found is not None and mark not in self._around(after, found)[k]


@dataclass(frozen=True)
class RapidConfiguration(Configuration):
    """ABB's cf1, cf4 and cf6, quarter turns of joints 1, 4 and 6, and cfx (RAPID reference manual, data type confdata).

    cfx numbers the eight postures of the arm: 4 if the wrist is behind axis 1, plus 2 if it is behind the lower arm,
    plus 1 if joint 5 is negative. Old programs have 0 there whatever the posture.
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
        """Return all marks; if not strictly, without cfx."""
        return self.marks if strictly else self.marks[:3]


@dataclass(frozen=True)
class FanucConfiguration(Configuration):
    """FANUC's CONFIG: wrist F(lip) or N, elbow U(p) or D(own), arm T (front) or B (back), turns of joints 1, 4 and 6.

    The wrist is not flipped if joint 5 is negative, as when the tool points down at J5 = -90 degrees.
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
    """KUKA's S and T (KRL reference guide); named: which of the two each flag is.

    Bit 0 of S is set if the arm reaches overhead, bit 1 if the elbow is up, bit 2 if A5 is negative; bit n of T is set
    if A(n + 1) is negative. Further bits have other meanings and stay unchanged.
    """

    named: tuple[str, ...]

    @property
    def marks(self) -> tuple[str, ...]:
        """The bits with a known meaning, of each flag from bit 0 on."""
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
        """Return the flags of which bits change, each with its new text."""
        bits, flags = iter(self._new(before, after)), []
        for name, flag in self._pairs:
            value = _krl_value(flag)
            for k in range(KRL_BITS[name]):
                if bit := next(bits):
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
    """A number of a program: its bytes [start, end) in the file, its text, and the factor from its unit to SI."""

    start: int
    end: int
    text: str
    scale: float

    @property
    def written(self) -> float:
        """Its value in the unit of the program."""
        return float(self.text)

    @property
    def value(self) -> float:
        """Its value in SI."""
        return self.written * self.scale


@dataclass(frozen=True)
class External:
    """The value of an external axis as written; unit: deg or mm where the program states it."""

    value: float
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Computed:
    """A pose that a program computes from a target: before @ target @ after (4, 4), with its name in messages."""

    name: str
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Use:
    """A move to a target: tool and frame (None if the program states none), and near: readings [rad] close to it.

    flagged: whether the controller observes the target's configuration; computed: the pose the move goes to, if not the
    target itself; file, line: its position; span: bytes [start, end) of the target's name there, if replaceable.
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
    """A target's declaration, bytes [start, end): head, name, sign, value [start, end), tail; remark: comment mark."""

    start: int
    end: int
    head: str
    sign: str
    value: tuple[int, int]
    tail: str
    remark: str


@dataclass(frozen=True)
class Target:
    """A target of a program, with the numbers that state it.

    If turn is None the numbers are joint readings; else the tool's position in a frame and its orientation: a
    quaternion (w, x, y, z), angles about z, y and x in turn, angles about fixed x, y and z, or a rotation vector. uses:
    the moves to it; external: the stated values of external axes by number; declared: its declaration, if its name has
    no other value.
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
        """The pose (4, 4) that the numbers state."""
        return pose_matrix(self.values, self.turn or "quaternion")

    @property
    def near(self) -> tuple[float, ...] | None:
        """The arm's readings that the program states as near the target, if any."""
        return next((use.near for use in self.uses if use.near), None)

    @property
    def flagged(self) -> bool:
        """Whether the controller observes its configuration."""
        return not self.uses or any(use.flagged for use in self.uses)


Reason = Literal[
    "computed", "shared", "relative", "changed on the way", "several tools or frames", "standing tool", "elsewhere", "never taught",
    "unknown tool or frame", "not read",
    "incomplete", "configuration", "out of reach", "singularity", "tool or frame", "no move",
]  # fmt: skip


@dataclass(frozen=True)
class Skipped:
    """A target or statement of a program that stays uncorrected, or whose effect is unknown, and why."""

    name: str
    line: int
    reason: Reason
    note: str


@dataclass(frozen=True, eq=False)
class Program:
    """A parsed program: its bytes, its targets in the order of the file, and what is skipped.

    tools, frames: poses (4, 4) by name, in SI, from all files of its project; file:
    its name in the project.
    """

    maker: Maker
    source: bytes
    targets: tuple[Target, ...]
    skipped: tuple[Skipped, ...] = ()
    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    frames: Mapping[str, np.ndarray] = field(default_factory=dict)
    file: str = ""
