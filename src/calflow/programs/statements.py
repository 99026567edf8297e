"""Statements: what the languages of robot programs have in common beyond expressions, and what is gathered on the way through one.

A language says of each of its compound statements how it begins, goes on and ends, as a phrase: its words as they are, and
`name`, `names`, `value`, `values` (several with commas between them), `arguments` or `rest` (of the line) for what stands there;
what may be left out is in brackets.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from calflow.programs.scanner import Expressions, Reader, refusal
from calflow.programs.target import Left, Maker, Program, Target

UNSTATED = "is gone to, and its numbers do not stand in this file"


@dataclass(frozen=True)
class Compound:
    """A statement with others inside: the phrase after its first word, its last word, and the phrases after those between."""

    head: str
    end: str
    branches: Mapping[str, str] = field(default_factory=dict)
    tail: str = ""  # the phrase after the last word


@dataclass(frozen=True)
class Use:
    """Tool and frame with which a move goes to a target, None where the program does not say, and readings [rad] near it.

    flagged: the controller heeds the target's configuration.
    """

    tool: str | None = None
    frame: str | None = None
    near: tuple[float, ...] | None = None
    flagged: bool = True


@dataclass
class Statements(ABC):
    """What is gathered on the way through a program; now has the tool and the frame in force, where the language has such."""

    maker: ClassVar[Maker]
    compounds: ClassVar[Mapping[str, Compound]]
    outer: ClassVar[tuple[str, ...]] = ()  # words that end what no statement may reach beyond
    lined: ClassVar[bool] = True  # whether a statement ends with its line

    reader: Reader
    values: Expressions
    targets: list[Target] = field(default_factory=list)
    left: list[Left] = field(default_factory=list)
    types: dict[str, str] = field(default_factory=dict)
    uses: dict[str, list[Use]] = field(default_factory=dict)
    gone_to: dict[str, Left] = field(default_factory=dict)
    now: Use = Use()

    @abstractmethod
    def statement(self) -> None:
        """Read a statement, with all that is inside it."""

    @staticmethod
    @abstractmethod
    def key(name: str) -> str:
        """Return what a name is known by: of several places of an array, or spelled otherwise, the same."""

    def phrase(self, words: str) -> None:
        """Read what a phrase says.

        Raises:
            InputError: something else is there.
        """
        parts: dict[str, Callable[[], object]] = {
            "name": self.name, "names": lambda: self.reader.separated(self.name), "value": self.value,
            "values": lambda: self.reader.separated(self.value), "arguments": self.values.arguments, "rest": self.rest,
        }  # fmt: skip
        for piece in re.findall(r"\[.+?\]|\S+", words):
            if piece in parts:
                parts[piece]()
            elif not piece.startswith("["):
                self.reader.expect(piece)
            elif self.reader.word == piece[1:-1].split()[0]:
                self.phrase(piece[1:-1])

    def name(self) -> None:
        """Read a name."""
        self.reader.kind("name", "a name")

    def value(self) -> None:
        """Read an expression."""
        self.values.expression()

    def rest(self) -> None:
        """Read the rest of a line, of which only brackets and words are looked at."""
        closing: list[str] = []
        while self.reader.next.kind not in ("newline", "end"):
            token = self.reader.take()
            if token.text in ("(", "[", "{"):
                closing.append({"(": ")", "[": "]", "{": "}"}[token.text])
            elif token.text in (")", "]", "}") and (not closing or closing.pop() != token.text):
                raise refusal(f"unexpected '{token.text}'", token)
        if closing:
            raise refusal(f"expected '{closing[-1]}', found {self.reader.next}", self.reader.next)

    def compound(self, word: str) -> None:
        """Read a compound statement: each branch begins with the tool and the frame before it.

        After it those are in force that all branches end with, where it changes none.
        """
        shape, before, after, end = self.compounds[word], self.now, list[Use](), ""
        opening = self.reader.take()
        self.phrase(shape.head)
        while end != shape.end:
            self.now = before
            end = self.body(*shape.branches, shape.end, of=f" of {opening} in line {opening.line}")
            self.phrase(shape.branches.get(end, shape.tail))
            after.append(self.now)
        self.now = Use(
            before.tool if all(one.tool == before.tool for one in after) else None,
            before.frame if all(one.frame == before.frame for one in after) else None,
        )

    def body(self, *ends: str, of: str = "") -> str:
        """Read statements up to one of the words that end them, of what messages say; return that word."""
        self.next_line()
        while (end := self.reader.accept(*ends)) is None:
            if self.reader.next.kind == "end" or (self.reader.next.kind == "name" and self.reader.word in self.closing):
                raise refusal(f"expected {' or '.join(ends)}{of}, found {self.reader.next}", self.reader.next)
            self.statement()
        return self.reader.folded(end)

    @cached_property
    def closing(self) -> frozenset[str]:
        """The words that end a statement or go on with one, or end what is around it."""
        inner = {word for one in self.compounds.values() for word in (one.end, *one.branches)}
        return frozenset(inner | set(self.outer))

    def next_line(self) -> None:
        """Take the end of a line, where statements end with theirs."""
        if self.lined:
            self.reader.end_of_line()

    def take(self, found: Target | Left) -> None:
        """Keep a target, or why it is left alone."""
        self.targets.append(found) if isinstance(found, Target) else self.left.append(found)

    def used(self, target: Target) -> list[Use]:
        """Return the uses of a target."""
        return self.uses.get(self.key(target.name), [])

    def program(self, source: bytes, tools: Mapping[str, np.ndarray], frames: Mapping[str, np.ndarray]) -> Program:
        """Return all that was found, each target with tools and frames of its uses, and what is left with why."""
        targets = []
        for target in self.targets:
            uses = self.used(target) if target.turn else []
            named = tuple(dict.fromkeys(use.tool for use in uses if use.tool))
            seen_in = tuple(dict.fromkeys(use.frame for use in uses if use.frame))
            near = next((use.near for use in uses if use.near), None)
            flagged = not uses or any(use.flagged for use in uses)
            targets.append(replace(target, tools=named, frames=seen_in, near=near, flagged=flagged))
        known = {self.key(one.name) for own in (self.targets, self.left) for one in own}
        elsewhere = [replace(one, note=UNSTATED) for name, one in self.gone_to.items() if name not in known]
        places, lines = {one.start for target in targets for one in target.numbers}, {one.line for one in self.left}
        loose = [
            Left(
                f"target in line {one.line}",
                one.line,
                "computed",
                "stands in an expression: where it leads is not known",
            )
            for one in self.values.literals
            if one.line not in lines and not any(part.start in places for part in one.walk() if part.kind == "number")
        ]
        targets.sort(key=lambda target: target.numbers[0].start)
        left = tuple(sorted([*self.left, *elsewhere, *loose], key=lambda one: one.line))
        return Program(self.maker, source, tuple(targets), left, tools, frames)
