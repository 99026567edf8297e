"""Statements: the analysis of a program's statements, common to all languages.

Reading a file collects its declarations and defers the effects of its statements until the symbol tables of all files
of the project are known.
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
from calflow.programs.names import GLOBAL, Project, Scope, SymbolTable, root, without_indices
from calflow.programs.syntax import Grammar, Node
from calflow.programs.target import Computed, Declaration, Maker, Program, Reason, Skipped, Target, Use

STATIONARY = "standing"  # a stationary tool beside the robot, which holds the workpiece
UNDECLARED = "is the target of a move, and its numbers do not stand in this file"
DEEPEST_NAME = 20  # nesting depth of names whose value is a name
LOCAL_MARK = "@"  # between a local name and its routine
INDIRECT = ("name", "call", "operation")  # kinds of values that may refer to targets


@dataclass(frozen=True, eq=False)
class Destination:
    """A destination of moves, before @ origin @ after; origin: a target's name or numbers; None: unknown transforms."""

    origin: Node
    before: np.ndarray | None = field(default_factory=lambda: NOWHERE)
    after: np.ndarray | None = field(default_factory=lambda: NOWHERE)

    def transformed(self, before: np.ndarray | None, after: np.ndarray | None) -> Destination:
        """Return the destination between two further transforms."""
        if before is None or after is None or self.before is None or self.after is None:
            return Destination(self.origin, None, None)
        return Destination(self.origin, _product(before, self.before), _product(self.after, after))


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the product of two transforms; NOWHERE, the identity, keeps its identity as an object."""
    return second if first is NOWHERE else first if second is NOWHERE else first @ second


@dataclass
class Statements(ABC):
    """The targets and moves of a file; active: the tool and frame in force, in languages that set them by statements."""

    maker: ClassVar[Maker]
    sign: ClassVar[str] = "="  # of assignment
    remark: ClassVar[str]  # the comment mark
    number_types: ClassVar[tuple[str, ...]] = ()  # types whose variables may change without an assignment
    flange: ClassVar[str]  # name of the tool at the flange
    base: ClassVar[str]  # name of the frame at the base
    grammar: ClassVar[Grammar]

    source: bytes
    file: str
    symbols: SymbolTable = field(init=False)
    scope: Scope = field(init=False)
    literals: list[Node] = field(default_factory=list)  # expressions with the shape of a target
    actions: list[Callable[[], None]] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    if_unused: dict[int, Skipped] = field(default_factory=dict)  # by byte position, as is defaults
    defaults: dict[int, Use] = field(default_factory=dict)  # tool and frame of moves that state none
    skipped: list[Skipped] = field(default_factory=list)
    uses: dict[tuple[str, str], list[Use]] = field(default_factory=dict)
    undeclared: dict[str, Skipped] = field(default_factory=dict)
    active: Use = field(default_factory=Use)

    def __post_init__(self) -> None:
        self.symbols = SymbolTable(self.group)

    @classmethod
    def of(cls, source: bytes, file: str) -> Self:
        """Read a file of the language.

        Raises:
            InputError: it cannot be parsed, with the line.
        """
        statements = cls(source, file)
        statements.read(cls.grammar.tree(source.decode("latin-1")))
        return statements

    @property
    def group(self) -> str:
        """Name of the group of files that share their private names."""
        return self.file

    def read(self, node: Node) -> None:
        """Read a node by the method named after its rule, or else its children."""
        getattr(self, f"read_{node.kind}", self.read_items)(node)

    def read_items(self, node: Node) -> None:
        """Read the children of a node."""
        for item in node.items:
            if item is not None:
                self.read(item)

    def read_branches(self, node: Node) -> None:
        """Read a statement with alternative blocks."""
        bodies = list[list[Callable[[], None]]]()
        outside = self.actions
        for item in node.items:
            if item is not None:
                self.actions = list[Callable[[], None]]() if item.kind == "block" else outside
                self.read(item)
                if item.kind == "block":
                    bodies.append(self.actions)
        self.actions = outside
        self.defer(self.run_branches, bodies)

    def add_assignment(self, node: Node) -> str:
        """Record an assignment, and return the name assigned to, without its components."""
        self.read_items(node)
        to, value = node.items
        whole, _, component = self.key(to.text).partition(".")
        fixed = all(item.kind == "number" for item in to.items)
        self.symbols.values[whole if fixed else root(whole)].append(
            value._replace(kind="computed") if component else value
        )
        return whole

    @staticmethod
    def folded(name: str) -> str:
        """Return a name in the language's canonical case."""
        return name

    def key(self, name: str) -> str:
        """Return the key of a name in symbol tables; for an array element with a variable index, the array's."""
        indexed = re.findall(r"[{\[]([^}\]]*)[}\]]", name)
        every = all(re.fullmatch(r"[\d,]*", index) for index in indexed)
        return self.folded(name if every else without_indices(name))

    @abstractmethod
    def is_literal(self, value: Node) -> bool:
        """Return whether a value in a move is a literal target."""

    @abstractmethod
    def target(self, name: str, value: Node) -> Target | Skipped:
        """Return the target of a literal in a move, or why it is skipped."""

    @abstractmethod
    def composed(self, value: Node, depth: int) -> Destination | None:
        """Return the destination that a call or operation computes from a target; None if unknown."""

    def destination(self, value: Node, depth: int = 0) -> Destination | None:
        """Return the destination that an expression denotes: a target, or a pose computed from one; None if unknown."""
        if self.is_literal(value):
            return Destination(value)
        if value.kind == "name":
            fixed = depth < DEEPEST_NAME and self.key(value.text) == self.folded(value.text)
            given = self.scope.value(self.key(value.text)) if fixed else None
            follows = given is not None and given.kind in INDIRECT
            return (self.destination(given, depth + 1) if given is not None and follows else None) or Destination(value)
        if value.kind == "operation" and not value.text:
            return self.destination(value.items[0], depth + 1)
        return self.composed(value, depth + 1)

    @abstractmethod
    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield "tool" or "frame", name and pose (4, 4), None if unknown, of the tools and frames that the file defines."""

    def with_local_names(self, routine: str, names: Collection[str], node: Node) -> Node:
        """Return a routine's tree with its local names made unique in the project."""
        if not names:
            return node
        items = tuple(item and self.with_local_names(routine, names, item) for item in node.items)
        first = root(node.text)
        if node.kind not in ("name", "token") or self.folded(first) not in names:
            return node._replace(items=items)
        return node._replace(text=f"{first}{LOCAL_MARK}{routine}{node.text[len(first) :]}", items=items)

    def resolved_name(self, name: str, depth: int = 0) -> str:
        """Return the key of a name, or of the name that is its value."""
        value = self.scope.value(self.key(name)) if depth < DEEPEST_NAME else None
        return self.key(name) if value is None or value.kind != "name" else self.resolved_name(value.text, depth + 1)

    def means_same(self, other: Statements, value: Node) -> bool:
        """Return whether a value in another file means the same in this one: all its names are global."""
        if self.symbols.group == other.symbols.group:
            return True
        owners = {
            f.scope.owner(f.key(node.text)) for f in (self, other) for node in value.walk() if node.kind == "name"
        }
        return value.kind in INDIRECT and owners == {GLOBAL}

    def defer(self, action: Callable[..., None], *arguments: object) -> None:
        """Defer an effect of a statement until the names of all files are known."""
        self.actions.append(partial(action, *arguments))

    def run_branches(self, bodies: Sequence[Sequence[Callable[[], None]]]) -> None:
        """Run alternative branches, each from the tool and frame before them; what any branch changes is then unknown."""
        before, after = self.active, list[Use]()
        for actions in bodies:
            self.active = before
            for action in actions:
                action()
            after.append(self.active)
        self.active = Use(
            before.tool if all(state.tool == before.tool for state in after) else None,
            before.frame if all(state.frame == before.frame for state in after) else None,
        )

    def activate(self, use: Use) -> None:
        """Set the active tool and frame."""
        self.active = use

    def skip(self, name: str, line: int, reason: Reason, note: str) -> None:
        """Record why a target or statement is skipped."""
        self.skipped.append(Skipped(name, line, reason, note))

    def add_target(
        self, found: Target | Skipped, *uses: Use, defaults: Use | None = None, if_unused: Skipped | None = None,
        declared: Declaration | None = None,
    ) -> None:  # fmt: skip
        """Record a target with its known uses, or why it is skipped.

        defaults: tool and frame of moves that state none; if_unused: recorded instead of a target without moves.
        """
        if isinstance(found, Skipped):
            self.skipped.append(found)
            return
        self.targets.append(replace(found, uses=uses, declared=declared))
        start = found.numbers[0].start
        self.defaults |= {start: defaults} if defaults else {}
        self.if_unused |= {start: if_unused} if if_unused else {}

    def declaration(
        self, start: int, head: str, name: str, value: Node, end: int, tail: str = ""
    ) -> Declaration | None:
        """Return the declaration in the bytes [start, end) of a name with a value; None if it has other values."""
        if self.scope.value(self.key(name)) is not value:
            return None
        return Declaration(start, end, head, self.sign, (value.start, value.end), tail, self.remark)

    def alternatives(self, goal: Destination) -> tuple[list[Destination], bool]:
        """Return the destinations assigned to the name of a destination, and whether these are all its values."""
        origin = goal.origin
        values = self.scope.values(self.key(origin.text)) if origin.kind == "name" else []
        given = [self.destination(value) if value.kind in INDIRECT else None for value in values]
        others = [other.transformed(goal.before, goal.after) for other in given if other]
        return others, 0 < len(values) == len(others)

    def add_move(
        self, goal: Destination | None, value: Node, name: str, line: int, use: Use, via: frozenset[str] = frozenset()
    ) -> None:
        """Record a move to the destination of a value; name, line: for messages; via: names resolved so far."""
        origin = goal.origin if goal else value
        if goal is None or origin.text in via:
            self.skip(name, line, "computed", "goes to a computed pose")
            return
        others, complete = self.alternatives(goal)
        for other in others:
            self.add_move(other, value, name, line, use, via | {origin.text})
        if complete:
            return
        label = self.scope.label
        tool, frame = use.tool and label(use.tool), use.frame and label(use.frame)
        use = replace(use, tool=tool, frame=frame, file=self.file, line=line)
        if goal.before is None or goal.after is None:
            shared = f"is computed from {_as_written(origin.text) or 'a target'}, whose correction it shares"
            self.skip(name, line, "shared", shared)
        elif goal.before is not NOWHERE or goal.after is not NOWHERE:
            use = replace(use, computed=Computed(_as_written(name), goal.before, goal.after))
        if origin.kind == "name":
            key = self.key(origin.text)
            written = key == self.folded(origin.text) and any(node is origin for node in value.walk())
            use = replace(use, span=(origin.start, origin.end) if written else None)
            self.uses.setdefault((self.scope.owner(key), key), []).append(use)
            self.undeclared.setdefault(key, Skipped(origin.text, line, "elsewhere", UNDECLARED))
        else:
            self.add_target(self.target(name, origin), use)

    def number(self, value: Node, depth: int = 0) -> float | None:
        """Return the value of an expression of numbers and constants; None if unknown."""
        if value.kind == "number":
            try:
                return float(value.text)
            except ValueError:  # hexadecimal
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
        """Return the program: targets with their uses in all files, and what is skipped and why."""
        count = Counter(self.key(target.name) for target in self.targets)
        resolved = [self.resolved(target, used, count[self.key(target.name)] == 1) for target in self.targets]
        targets = sorted((e for e in resolved if isinstance(e, Target)), key=lambda target: target.numbers[0].start)
        skipped = [*self.skipped, *(entry for entry in resolved if isinstance(entry, Skipped))]
        skipped += [entry for name, entry in self.undeclared.items() if (self.scope.owner(name), name) not in known]
        skipped += self.unread_literals({entry.line for entry in skipped})
        skipped.sort(key=lambda entry: entry.line)
        unread = tuple(replace(entry, name=_as_written(entry.name)) for entry in skipped)
        return Program(self.maker, self.source, tuple(targets), unread, file=self.file)

    def resolved(self, target: Target, used: Mapping[tuple[str, str], Sequence[Use]], alone: bool) -> Target | Skipped:
        """Return a target with its uses in all files, or why it is skipped; alone: no other has its name."""
        key, start = self.key(target.name), target.numbers[0].start
        owner = self.scope.owner(key)
        moves = [use for name in dict.fromkeys((key, without_indices(key))) for use in used.get((owner, name), ())]
        uses = (*target.uses, *moves)
        if default := self.defaults.get(start) if target.turn else None:
            uses = tuple(
                replace(use, tool=use.tool or default.tool, frame=use.frame or default.frame)
                for use in uses or (default,)
            )
        if target.turn and any(use.tool == STATIONARY for use in uses):
            return Skipped(target.name, target.line, "standing tool", "is of a stationary tool")
        declared, name = target.declared if alone else None, _as_written(target.name)
        unused = None if moves else self.if_unused.get(start)
        return unused or replace(target, name=name, uses=uses, declared=declared)

    def unread_literals(self, lines: Collection[int]) -> list[Skipped]:
        """Return the literals that are no target, except in lines that something else is said of."""
        places = {number.start for target in self.targets for number in target.numbers}
        where = "stands in an expression: its pose is unknown"
        return [
            Skipped(f"target in line {node.line}", node.line, "computed", where)
            for node in self.literals
            if node.line not in lines and not any(part.start in places for part in node.walk() if part.kind == "number")
        ]


def _as_written(name: str) -> str:
    """Return a name as written in the program."""
    return re.sub(rf"{LOCAL_MARK}\w+", "", name)


def _bind_arguments(files: Sequence[Statements]) -> None:
    """Assign the arguments of calls to the parameters of routines; those of private names count as computed."""
    routines: dict[str, list[Statements]] = defaultdict(list)
    for file in files:
        for routine in file.symbols.parameters:
            routines[routine].append(file)
    for caller in files:
        for call in caller.symbols.calls:
            for file in routines.get(call.routine, ()):
                for parameter, argument in zip(file.symbols.parameters[call.routine], call.arguments, strict=False):
                    if file.scope.type_of(parameter) not in file.number_types:
                        value = argument if file.means_same(caller, argument) else argument._replace(kind="computed")
                        file.scope.project.values[file.scope.owner(parameter), parameter].append(value)


def link(files: Sequence[Statements]) -> tuple[list[Program], list[Problem]]:
    """Return the programs of a project, names resolved across files, and the problems of files that are none."""
    project = Project(file.symbols for file in files)
    tools = {file.flange: NOWHERE for file in files}
    frames = {file.base: NOWHERE for file in files}
    for file in files:
        file.scope = Scope(project, file.symbols.group)
    _bind_arguments(files)
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
        keys = [*(file.key(target.name) for target in file.targets), *(file.key(entry.name) for entry in file.skipped)]
        known |= {(file.scope.owner(key), name) for key in keys for name in (key, without_indices(key))}
    return [replace(file.linked(used, known), tools=tools, frames=frames) for file in fine], wrong
