"""Statements: what the languages of robot programs have in common, and what is gathered on the way through a program.

A file is read for what it declares; what its statements do is looked at later, when the names of all files of the project are
known.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from calflow.deployment.conventions import NOWHERE
from calflow.files.problems import InputError, Problem
from calflow.programs.names import SHARED, Declared, Project, Scope, root
from calflow.programs.syntax import Grammar, Node
from calflow.programs.target import Computed, Declaration, Left, Maker, Program, Reason, Target, Use

STANDING = "standing"  # a tool beside the robot, which has the work piece
UNSTATED = "is gone to, and its numbers do not stand in this file"
DEEPEST_NAME = 20  # names that stand for names
OF_ROUTINE = "@"  # between a name that a routine has for itself and the routine
FOLLOWED = ("name", "call", "operation")  # values that may be other targets, or composed of such


@dataclass(frozen=True, eq=False)
class Place:
    """Where a move goes: before @ origin @ after, of the name or the numbers of a target; None where by how much is not known."""

    origin: Node
    before: np.ndarray | None = field(default_factory=lambda: NOWHERE)
    after: np.ndarray | None = field(default_factory=lambda: NOWHERE)

    def moved(self, before: np.ndarray | None, after: np.ndarray | None) -> Place:
        """Return the place further from its origin."""
        if before is None or after is None or self.before is None or self.after is None:
            return Place(self.origin, None, None)
        return Place(self.origin, _product(before, self.before), _product(self.after, after))


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Two transforms in turn, of which one that leads nowhere stays known as such."""
    return second if first is NOWHERE else first if second is NOWHERE else first @ second


@dataclass
class Statements(ABC):
    """What is gathered on the way through a program; now has the tool and the frame in force, where the language has such."""

    maker: ClassVar[Maker]
    sign: ClassVar[str] = "="  # between a name and its value
    remark: ClassVar[str]  # what begins a remark
    counted: ClassVar[tuple[str, ...]] = ()  # types of numbers, which are changed without an assignment
    flange: ClassVar[str]  # how the tool is called that is none, and the frame
    base: ClassVar[str]
    grammar: ClassVar[Grammar]

    source: bytes
    file: str
    declared: Declared = field(init=False)
    scope: Scope = field(init=False)
    literals: list[Node] = field(default_factory=list)  # what has the shape of a target in expressions
    actions: list[Callable[[], None]] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    optional: dict[int, Left] = field(default_factory=dict)
    taught: dict[int, Use] = field(default_factory=dict)  # with what a target is gone to where its moves do not say
    left: list[Left] = field(default_factory=list)
    uses: dict[tuple[str, str], list[Use]] = field(default_factory=dict)
    gone_to: dict[str, Left] = field(default_factory=dict)
    now: Use = field(default_factory=Use)

    def __post_init__(self) -> None:
        self.declared = Declared(self.group)

    @classmethod
    def of(cls, source: bytes, file: str) -> Self:
        """Read a file of the language.

        Raises:
            InputError: it is not the language as this reads it, with the line.
        """
        statements = cls(source, file)
        statements.read(cls.grammar.tree(source.decode("latin-1")))
        return statements

    @property
    def group(self) -> str:
        """What files are called that see each other's private names."""
        return self.file

    def read(self, node: Node) -> None:
        """Read a node of the tree: as the method says that is called after its rule, or else all that it is made of."""
        getattr(self, f"read_{node.kind}", self.read_items)(node)

    def read_items(self, node: Node) -> None:
        """Read all that a node is made of."""
        for item in node.items:
            if item is not None:
                self.read(item)

    def read_branches(self, node: Node) -> None:
        """Read a statement with blocks, one of which is gone through."""
        bodies = list[list[Callable[[], None]]]()
        outside = self.actions
        for item in node.items:
            if item is not None:
                self.actions = list[Callable[[], None]]() if item.kind == "block" else outside
                self.read(item)
                if item.kind == "block":
                    bodies.append(self.actions)
        self.actions = outside
        self.later(self.branch, bodies)

    def assigned(self, node: Node) -> str:
        """Read a value and the name that it is given to, and return this without its components."""
        self.read_items(node)
        to, value = node.items
        whole, _, component = self.key(to.text).partition(".")
        fixed = all(item.kind == "number" for item in to.items)
        self.declared.values[whole if fixed else root(whole)].append(
            value._replace(kind="computed") if component else value
        )
        return whole

    @staticmethod
    def folded(name: str) -> str:
        """Return a name as the language compares it."""
        return name

    def key(self, name: str) -> str:
        """Return what a name is known by: spelled otherwise, the same; a place of an array that a variable says is as all."""
        indexed = re.findall(r"[{\[]([^}\]]*)[}\]]", name)
        every = all(re.fullmatch(r"[\d,]*", index) for index in indexed)
        return self.folded(name if every else without_indices(name))

    @abstractmethod
    def is_literal(self, value: Node) -> bool:
        """Return whether a value in a move has the shape of a target."""

    @abstractmethod
    def target(self, name: str, value: Node) -> Target | Left:
        """Return the target that a value in a move states, or why it is left alone."""

    @abstractmethod
    def composed(self, value: Node, depth: int) -> Place | None:
        """Return the place that a call or an operation makes of a target; None where that is not known."""

    def place(self, value: Node, depth: int = 0) -> Place | None:
        """Return the place that an expression means: a target's by its name or its numbers, or what is composed of one."""
        if self.is_literal(value):
            return Place(value)
        if value.kind == "name":
            fixed = depth < DEEPEST_NAME and self.key(value.text) == self.folded(value.text)
            given = self.scope.value(self.key(value.text)) if fixed else None
            follows = given is not None and given.kind in FOLLOWED
            return (self.place(given, depth + 1) if given is not None and follows else None) or Place(value)
        if value.kind == "operation" and not value.text:
            return self.place(value.items[0], depth + 1)
        return self.composed(value, depth + 1)

    @abstractmethod
    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield of each tool and frame that the file states which of both it is, its name, and where it is (4, 4), if known."""

    def with_names_of(self, routine: str, names: Collection[str], node: Node) -> Node:
        """Return a routine's tree in which names that it has for itself are others than those of any other."""
        if not names:
            return node
        items = tuple(item and self.with_names_of(routine, names, item) for item in node.items)
        first = root(node.text)
        if node.kind not in ("name", "token") or self.folded(first) not in names:
            return node._replace(items=items)
        return node._replace(text=f"{first}{OF_ROUTINE}{routine}{node.text[len(first) :]}", items=items)

    def meant(self, name: str, depth: int = 0) -> str:
        """Return by what a name is known that stands for another, wherever the project gives it one, or by what it is itself."""
        value = self.scope.value(self.key(name)) if depth < DEEPEST_NAME else None
        return self.key(name) if value is None or value.kind != "name" else self.meant(value.text, depth + 1)

    def sees(self, other: Statements, value: Node) -> bool:
        """Return whether a value in another file means the same in this one: it is made of names that both share."""
        if self.declared.group == other.declared.group:
            return True
        owners = {
            f.scope.owner(f.key(node.text)) for f in (self, other) for node in value.walk() if node.kind == "name"
        }
        return value.kind in FOLLOWED and owners == {SHARED}

    def later(self, action: Callable[..., None], *arguments: object) -> None:
        """Keep what a statement does for when the names of all files are known."""
        self.actions.append(partial(action, *arguments))

    def branch(self, bodies: Sequence[Sequence[Callable[[], None]]]) -> None:
        """Do what the branches of a statement do: each begins with the tool and the frame before it.

        After it those are in force that all branches end with, where it changes none.
        """
        before, after = self.now, list[Use]()
        for actions in bodies:
            self.now = before
            for action in actions:
                action()
            after.append(self.now)
        self.now = Use(
            before.tool if all(state.tool == before.tool for state in after) else None,
            before.frame if all(state.frame == before.frame for state in after) else None,
        )

    def enter(self, use: Use) -> None:
        """Have a tool and a frame in force."""
        self.now = use

    def leave(self, name: str, line: int, reason: Reason, note: str) -> None:
        """Keep why something is left alone."""
        self.left.append(Left(name, line, reason, note))

    def take(
        self, found: Target | Left, *uses: Use, taught: Use | None = None, unless_used: Left | None = None,
        declared: Declaration | None = None,
    ) -> None:  # fmt: skip
        """Keep a target, with its uses where they are known, or why it is left alone.

        taught has tool and frame of moves that do not say theirs. unless_used is kept in the place of a target to which no move
        goes.
        """
        if isinstance(found, Left):
            self.left.append(found)
            return
        self.targets.append(replace(found, uses=uses, declared=declared))
        start = found.numbers[0].start
        self.taught |= {start: taught} if taught else {}
        self.optional |= {start: unless_used} if unless_used else {}

    def declared_as(
        self, start: int, head: str, name: str, value: Node, end: int, tail: str = ""
    ) -> Declaration | None:
        """Return how a name with a value is declared, of which the bytes [start, end) are; None where it has other values."""
        key = self.key(name)
        if self.scope.value(key) is not value:
            return None
        return Declaration(start, end, head, self.sign, (value.start, value.end), tail, self.remark)

    def alternatives(self, place: Place) -> tuple[list[Place], bool]:
        """Return the places of other targets that the name of one is given, one here and another there; and whether that is all."""
        origin = place.origin
        values = self.scope.values(self.key(origin.text)) if origin.kind == "name" else []
        given = [self.place(value) if value.kind in FOLLOWED else None for value in values]
        others = [other.moved(place.before, place.after) for other in given if other]
        return others, 0 < len(values) == len(others)

    def go_to(
        self, place: Place | None, value: Node, name: str, line: int, use: Use, passed: frozenset[str] = frozenset()
    ) -> None:
        """Keep that a move goes to a place, which a value says, of which messages say a name and a line.

        passed has the names by which it came to the place.
        """
        origin = place.origin if place else value
        if place is None or origin.text in passed:
            self.leave(name, line, "computed", "goes to a place that is computed")
            return
        others, complete = self.alternatives(place)
        for other in others:
            self.go_to(other, value, name, line, use, passed | {origin.text})
        if complete:
            return
        label = self.scope.label
        tool, frame = use.tool and label(use.tool), use.frame and label(use.frame)
        use = replace(use, tool=tool, frame=frame, file=self.file, line=line)
        if place.before is None or place.after is None:
            shared = f"is computed from {_as_written(origin.text) or 'a target'}, whose correction it shares"
            self.leave(name, line, "shared", shared)
        elif place.before is not NOWHERE or place.after is not NOWHERE:
            use = replace(use, computed=Computed(_as_written(name), place.before, place.after))
        if origin.kind == "name":
            key = self.key(origin.text)
            written = key == self.folded(origin.text) and any(node is origin for node in value.walk())
            use = replace(use, span=(origin.start, origin.end) if written else None)
            self.uses.setdefault((self.scope.owner(key), key), []).append(use)
            self.gone_to.setdefault(key, Left(origin.text, line, "elsewhere", UNSTATED))
        else:
            self.take(self.target(name, origin), use)

    def number(self, value: Node, depth: int = 0) -> float | None:
        """Return the number that an expression is, of numbers and constants; None where that is not known."""
        if value.kind == "number":
            try:
                return float(value.text)
            except ValueError:  # a hexadecimal one
                return None
        if value.kind == "name" and depth < DEEPEST_NAME:
            resolved = self.scope.value(self.key(value.text))
            return None if resolved is None else self.number(resolved, depth + 1)
        if value.kind != "operation" or not set(value.text) <= set("+-*/ "):
            return None
        terms = [self.number(item, depth + 1) for item in value.items]
        numbers = [term for term in terms if term is not None]
        signs = value.text.split()
        if len(numbers) < len(terms) or not terms:
            return None
        if len(terms) == 1:
            return numbers[0] * (-1) ** signs.count("-") if set(signs) <= set("+-") else None
        total, product, sign = 0.0, numbers[0], 1.0
        for operator, number in zip(signs, numbers[1:], strict=True):
            if operator in "+-":
                total, product, sign = total + sign * product, number, -1.0 if operator == "-" else 1.0
            elif operator == "/" and number == 0:
                return None
            else:
                product = product * number if operator == "*" else product / number
        return total + sign * product

    def linked(self, used: Mapping[tuple[str, str], Sequence[Use]], known: Collection[tuple[str, str]]) -> Program:
        """Return all that was found, each target with its uses in all files, and what is left with why."""
        targets, left = [], list(self.left)
        keys = Counter(self.key(target.name) for target in self.targets)
        for target in self.targets:
            key, start = self.key(target.name), target.numbers[0].start
            owner = self.scope.owner(key)
            moves = [use for name in dict.fromkeys((key, without_indices(key))) for use in used.get((owner, name), ())]
            uses = (*target.uses, *moves) if target.turn else ()
            if taught := self.taught.get(start) if target.turn else None:
                uses = tuple(
                    replace(use, tool=use.tool or taught.tool, frame=use.frame or taught.frame)
                    for use in uses or (taught,)
                )
            if any(use.tool == STANDING for use in uses):
                left.append(Left(target.name, target.line, "standing tool", "is of a tool that stands still"))
            elif (unused := self.optional.get(start)) and not moves:
                left.append(unused)
            else:
                declared = target.declared if keys[key] == 1 else None
                targets.append(replace(target, uses=uses, declared=declared))
        left += [gone for name, gone in self.gone_to.items() if (self.scope.owner(name), name) not in known]
        places = {number.start for target in self.targets for number in target.numbers}
        lines = {skipped.line for skipped in left}
        where = "stands in an expression: where it leads is not known"
        left += [
            Left(f"target in line {literal.line}", literal.line, "computed", where)
            for literal in self.literals
            if literal.line not in lines
            and not any(part.start in places for part in literal.walk() if part.kind == "number")
        ]
        targets.sort(key=lambda target: target.numbers[0].start)
        left.sort(key=lambda skipped: skipped.line)
        written = tuple(replace(target, name=_as_written(target.name)) for target in targets)
        unread = tuple(replace(skipped, name=_as_written(skipped.name)) for skipped in left)
        return Program(self.maker, self.source, written, unread, file=self.file)


def _as_written(name: str) -> str:
    """Return a name as the program has it."""
    return re.sub(rf"{OF_ROUTINE}\w+", "", name)


def without_indices(name: str) -> str:
    """Return the name of an array's place without its indices."""
    return re.sub(r"[{\[][^}\]]*[}\]]", "", name)


def _pass_on(files: Sequence[Statements]) -> None:
    """Take what calls give to routines for values of their parameters, as far as it means the same there."""
    routines: dict[str, list[Statements]] = defaultdict(list)
    for file in files:
        for routine in file.declared.parameters:
            routines[routine].append(file)
    for caller in files:
        for call in caller.declared.calls:
            for file in routines.get(call.routine, ()):
                for parameter, argument in zip(file.declared.parameters[call.routine], call.arguments, strict=False):
                    if file.scope.type_of(parameter) not in file.counted:
                        value = argument if file.sees(caller, argument) else argument._replace(kind="computed")
                        file.scope.project.values[file.scope.owner(parameter), parameter].append(value)


def link(files: Sequence[Statements]) -> tuple[list[Program], list[Problem]]:
    """Return the programs of a project, whose names mean the same in all files, and what is wrong with files that are none."""
    project = Project(file.declared for file in files)
    tools = {file.flange: NOWHERE for file in files}
    frames = {file.base: NOWHERE for file in files}
    for file in files:
        file.scope = Scope(project, file.declared.group)
    _pass_on(files)
    used: dict[tuple[str, str], list[Use]] = {}
    known: set[tuple[str, str]] = set()
    fine, wrong = list[Statements](), list[Problem]()
    for file in files:
        try:
            for action in file.actions:
                action()
        except InputError as error:
            wrong += [replace(problem, file=Path(file.file)) for problem in error.problems]
            continue
        fine.append(file)
        for what, name, matrix in file.frames():
            if matrix is not None:
                (tools if what == "tool" else frames)[name] = matrix
        for key, uses in file.uses.items():
            used.setdefault(key, []).extend(uses)
        keys = [*(file.key(target.name) for target in file.targets), *(file.key(skipped.name) for skipped in file.left)]
        known |= {(file.scope.owner(key), name) for key in keys for name in (key, without_indices(key))}
    return [replace(file.linked(used, known), tools=tools, frames=frames) for file in fine], wrong
