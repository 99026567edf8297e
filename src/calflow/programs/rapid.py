"""RAPID: programs of ABB robots, by the RAPID reference manual's grammar of modules, data and routines."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOTATIONS, NOWHERE, UNIT_LENGTH
from calflow.files.deferred import Rotation
from calflow.files.problems import refuse
from calflow.programs.names import ALIAS, Call
from calflow.programs.statements import INDIRECT, Destination, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder
from calflow.programs.target import External, Flag, RapidConfiguration, Skipped, Target, Use

NOTATION = NOTATIONS["rapid"]
EXTERNAL = 6  # external axes of a target
# Numbers of values in the lists of a target.
SHAPES = {"robtarget": [3, 4, 4, EXTERNAL], "jointtarget": [6, EXTERNAL]}
PLACEHOLDER = 9e9  # a value not defined, as of an external axis that does not exist
UNDEFINED = 8.9e9  # from here on
SUFFIXES = (".mod", ".modx", ".sys", ".sysx", ".prg")
BEGINS = re.compile(r"(?:\xef\xbb\xbf)?(?:\s|![^\r\n]*|%%%[^%]*%%%)*MODULE\s", re.IGNORECASE)
# Number of leading arguments that are targets.
TARGET_ARGUMENTS = {"MOVEJ": 1, "MOVEL": 1, "MOVEABSJ": 1, "MOVEC": 2}
JOINTWISE = re.compile("(?:MOVE|TRIGG|PAINT|ARC|SPOT)J")
MOVING = ("MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "DISP", "PAINT", "CALIB")
DISPLACING = ("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET")


def rapid_target(name: str, kind: str, value: Node) -> Target | Skipped:
    """Return the robtarget or jointtarget of a value, or why it is skipped.

    Raises:
        InputError: the value does not have the shape of one.
    """
    computed = Skipped(name, value.line, "computed", "is computed")
    if value.kind != "list":
        return computed
    sizes = SHAPES[kind]
    groups = value.items
    if len(groups) == len(sizes) and any(group.kind != "list" for group in groups):
        return computed
    if _shape(value) != sizes:
        shape = ", ".join(f"[{size}]" for size in sizes)
        raise refuse(f"{name}: expected a {kind} of {len(sizes)} lists with {shape} values", line=value.line)
    if any(item.kind != "number" for group in groups for item in group.items):
        return computed
    if any(float(item.text) == PLACEHOLDER for group in groups[:-1] for item in group.items):
        return Skipped(name, value.line, "never taught", "has 9E9 in place of a number")
    axes = {k: External(float(item.text)) for k, item in enumerate(groups[-1].items, start=1)}
    external = {k: axis for k, axis in axes.items() if abs(axis.value) < UNDEFINED}
    if kind == "jointtarget":
        joints = tuple(item.number(np.pi / 180) for item in groups[0].items)
        return Target(name, value.line, joints, None, external=external)
    for item in groups[2].items:
        if re.fullmatch(r"[+-]?\d+(?:\.0*)?(?:[eE][+]?0+)?", item.text) is None:
            raise refuse(f"{name}: expected a whole number in its configuration, found '{item.text}'", line=item.line)
    flags = tuple(Flag(item.start, item.end, str(int(float(item.text)))) for item in groups[2].items)
    items = (*groups[0].items, *groups[1].items)
    numbers = tuple(item.number(scale) for item, scale in zip(items, NOTATION.scales, strict=True))
    return Target(name, value.line, numbers, NOTATION.turn, RapidConfiguration(flags), external=external)


def _tool(value: Node) -> np.ndarray | None:
    """[TRUE, [[x, y, z], [q1, q2, q3, q4]], [load]] as a transform; None for a stationary tool."""
    if len(value.items) != 3 or value.items[0].text.upper() != "TRUE":
        return None
    return _pose(value.items[1])


def _work_object(value: Node) -> np.ndarray | None:
    """[FALSE, TRUE, "", user frame, object frame] as a transform; None for a moving one."""
    if len(value.items) != 5 or [item.text.upper() for item in value.items[:3]] != ["FALSE", "TRUE", '""']:
        return None
    user, object_frame = _pose(value.items[3]), _pose(value.items[4])
    return None if user is None or object_frame is None else user @ object_frame


def _pose(value: Node) -> np.ndarray | None:
    """[[x, y, z], [q1, q2, q3, q4]] as a transform; None unless all are numbers."""
    if [len(item.items) for item in value.items] != [3, 4]:
        return None
    items = [item for group in value.items for item in group.items]
    if any(item.kind != "number" for item in items):
        return None
    values = np.array([item.number(1.0).written for item in items])
    usual = np.isfinite(values).all() and abs(np.linalg.norm(values[3:]) - 1) < UNIT_LENGTH
    return NOTATION.pose(values) if usual else None


def _shape(value: Node) -> list[int]:
    """Return the numbers of values in the lists of a value."""
    return [len(group.items) for group in value.items]


class _Builder(TreeBuilder):
    """RAPID has indices in braces, and optional arguments that are passed on."""

    brackets = ("{", "}")

    def passed(self, children: Sequence[Any]) -> Node:
        """An optional argument passed on if present: \\Option?parameter."""
        name, value = children
        return self.keyword([name, value._replace(text=f"?{value.text}")])


@dataclass
class RapidModules(Statements):
    """A file of modules; unmonitored: CONFL, CONFJ, if it switches off configuration monitoring anywhere."""

    unmonitored: set[str] = field(default_factory=set)

    maker, flange, base = "rapid", "tool0", "wobj0"
    sign, remark, number_types = ":=", "!", ("num",)
    grammar = Grammar("expressions", "rapid", builder=_Builder())

    @staticmethod
    def folded(name: str) -> str:
        """Return a name in lower case, which RAPID ignores."""
        return name.lower()

    def read_data(self, node: Node, inside: bool = False) -> None:
        """LOCAL VAR type name {dimensions} := value, ...; inside: of a routine."""
        self.read_items(node)
        scope, storage, kind_token, *variables, _ = node.items
        kind, head = kind_token.text.lower(), self.source[node.start : kind_token.start].decode("latin-1")
        constant = storage.text.upper() == "CONST"
        for name, shape, value in (variable.items for variable in variables):
            self.declare(name.text, kind, inside or (scope is not None and scope.text.upper() == "LOCAL"))
            dimensions = len(shape.items) if shape else 0
            if constant and value is None:
                raise refuse(f"expected a value of the constant {name.text}", line=name.line)
            if value is not None:
                if constant or kind not in self.number_types:
                    self.add_initial(name.text.lower(), dimensions, value)
                self.defer(self.assign_value, name.text, kind, dimensions, value, (node.start, head, node.end))

    def read_inner_data(self, node: Node) -> None:
        """Data declared in a routine."""
        self.read_data(node.items[0], inside=True)

    def declare(self, name: str, kind: str, private: bool) -> None:
        """Record the type of a name."""
        self.symbols.types[name.lower()] = kind
        if private:
            self.symbols.private.add(name.lower())

    def add_initial(self, name: str, dimensions: int, value: Node) -> None:
        """Record the initial value of a name, or of each element of an array."""
        if not dimensions:
            self.symbols.values[name].append(value)
        elif value.kind == "list":
            for k, item in enumerate(value.items, start=1):
                self.add_initial(_indexed(name, k), dimensions - 1, item)

    def assign_value(
        self, name: str, kind: str, dimensions: int, value: Node, place: tuple[int, str, int] | None = None
    ) -> None:
        """Record the targets in a value assigned to a name; place: start, head and end of a declaration."""
        kind = self.scope.resolved(kind)
        if dimensions and value.kind == "list":
            for k, item in enumerate(value.items, start=1):
                self.assign_value(_indexed(name, k), kind, dimensions - 1, item, place)
        elif kind in SHAPES and (dimensions or value.kind not in INDIRECT or self.destination(value) is None):
            found = (
                Skipped(name, value.line, "computed", "is computed") if dimensions else rapid_target(name, kind, value)
            )
            declared = None
            if place:
                start, head, end = place
                declared = self.declaration(start, f"{head}{kind} ", name, value, end, ";")
            self.add_target(found, declared=declared)
        elif kind in self.scope.project.components and value.kind == "list":
            for (part, inner), item in zip(self.scope.project.components[kind].items(), value.items, strict=False):
                self.assign_value(f"{name}.{part}", inner, 0, item, place)
        elif kind not in SHAPES and _shape(value) in SHAPES.values():
            self.skip(name, value.line, "no move", f"looks like a target, but is a {kind}")

    def read_record(self, node: Node) -> None:
        """RECORD name type component; ... ENDRECORD"""
        name, *members = node.items
        for kind, member in (member.items for member in members):
            self.symbols.components[name.text.lower()][member.text.lower()] = kind.text.lower()

    def read_alias(self, node: Node) -> None:
        """ALIAS type name;"""
        kind, name = node.items
        self.symbols.components[name.text.lower()][ALIAS] = kind.text.lower()

    def read_routine(self, node: Node) -> None:
        """PROC name(parameters) ... ENDPROC; FUNC, TRAP."""
        names = [item.text.lower() for item in node.items if item is not None and item.kind == "token"]
        own = {name.text.lower() for item in node.items if item is not None for name in _local_names(item)}
        node = self.with_local_names(names[-1], own, node)
        for parameters in (item for item in node.items if item is not None and item.kind == "parameters"):
            self.symbols.parameters[names[-1]] = [
                parameter.items[-1].text.lower()
                for parameter in parameters.items
                if len(parameter.items) == 2 and parameter.items[-1]
            ]
        self.read_items(node)

    def read_parameter(self, node: Node) -> None:
        """A routine's parameter, type name; a switch may have no type."""
        *_, kind, name = node.items
        if name is not None:
            self.declare(name.text, kind.text.lower(), private=True)

    def read_list(self, node: Node) -> None:
        """A list in an expression, possibly a literal target."""
        if _shape(node) in SHAPES.values():
            self.literals.append(node)
        else:
            self.read_items(node)

    def read_instruction(self, node: Node) -> None:
        """Instruction a, b \\Option:=c; or Instruction(a);"""
        self.read_items(node)
        name, given = node.items
        arguments = given.items if given is not None else name.items if name.kind == "call" else ()
        instruction = name.text.upper()
        if instruction in ("CONFL", "CONFJ") and "OFF" in {argument.text.upper() for argument in arguments}:
            self.unmonitored.add(instruction)
        positional = [item for item in arguments if item.kind != "keyword"]
        self.symbols.calls.append(Call("", name.text.lower(), positional))
        self.defer(self.move, name, arguments)

    def read_assignment(self, node: Node) -> None:
        """name := value;"""
        self.add_assignment(node)
        self.defer(self.assign, *node.items)

    def assign(self, to: Node, value: Node) -> None:
        """Record an assignment in a routine to a target, or to a part of one."""
        kind, *parts = self.scope.type_of(to.text.lower()), *to.text.lower().split(".")[:-1]
        if kind in SHAPES:
            self.assign_value(to.text, kind, 0, value)
        elif any(self.scope.type_of(whole) in SHAPES for whole in accumulate(parts, "{}.{}".format)):
            why = f"changes {to.text.partition('.')[2]} of a target on the way: the result is unknown"
            self.skip(to.text, to.line, "changed on the way", why)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield tools and work objects; their poses if defined once, by numbers."""
        for name, values in self.symbols.values.items():
            kind = self.scope.type_of(name)
            if kind not in ("tooldata", "wobjdata"):
                continue
            value = self.scope.value(name)
            matrix = None if value is None else _tool(value) if kind == "tooldata" else _work_object(value)
            if matrix is None:
                unusual = "is not defined by numbers alone, is a stationary tool or a moving work object, or has no unit quaternion"
                why = "is set more than once" if value is None else unusual
                self.skip(name, values[0].line, "tool or frame", why)
            yield "tool" if kind == "tooldata" else "frame", self.scope.label(name), matrix

    def move(self, name: Node, arguments: Iterable[Node]) -> None:
        """Record the moves of an instruction."""
        instruction = name.text.upper()
        whole = Node("call", name.text, name.start, name.end, name.line, tuple(arguments))
        places = whole.arguments
        if instruction in DISPLACING:
            self.skip(name.text, name.line, "shared", "displaces later targets, which are corrected as if it did not")
        if not instruction.startswith(MOVING):
            return
        at = 4 if instruction.startswith("MOVEC") else 3 if instruction.startswith("MOVE") else len(places) - 1
        tool = places[at].text if 0 <= at < len(places) and places[at].kind == "name" else ""
        frame = whole.keyword("wobj")
        monitored = ("CONFJ" if JOINTWISE.match(instruction) else "CONFL") not in self.unmonitored
        use = Use(self.resolved_name(tool), self.resolved_name(frame.text if frame else self.base), flagged=monitored)
        for k, value in enumerate(places):
            if instruction.startswith("SEARCH") and k == 1:  # its result: the pose found
                continue
            if k < TARGET_ARGUMENTS.get(instruction, 0) or self.is_literal(value) or self.involves_target(value):
                named = {"name": value.text, "call": f"{value.text}(…)"}.get(value.kind, f"target in line {value.line}")
                self.add_move(self.destination(value), value, named, value.line, use)

    def composed(self, value: Node, depth: int) -> Destination | None:
        """The destination that Offs or RelTool computes from a target."""
        if value.kind != "call" or not value.items:
            return None
        function = value.text.upper()
        inner = self.destination(value.items[0], depth) if function in ("OFFS", "RELTOOL") else None
        if inner is None:
            origin = next((item for item in value.items if self.involves_target(item)), None)
            return None if origin is None else Destination(origin, None, None)
        numbers = [self.number(item) for item in value.arguments[1:4]]
        turns = [value.keyword(axis) for axis in ("rx", "ry", "rz")]
        angles = [0.0 if turn is None else self.number(turn) for turn in turns]
        if len(numbers) < 3 or None in (*numbers, *angles):
            return inner.transformed(None, None)
        shift = np.eye(4)
        shift[:3, 3] = 1e-3 * np.array(numbers, dtype=float)
        if function == "OFFS":
            return inner.transformed(shift, NOWHERE)
        shift[:3, :3] = Rotation.from_euler("XYZ", np.array(angles, dtype=float), degrees=True).as_matrix()
        return inner.transformed(NOWHERE, shift)

    def is_literal(self, value: Node) -> bool:
        """Whether a value in a move is a literal target."""
        return value.kind == "list" and len(value.items) in (2, 4) and all(item.kind == "list" for item in value.items)

    def target(self, name: str, value: Node) -> Target | Skipped:
        """The target of a literal in a move."""
        return rapid_target(name, "robtarget" if len(value.items) == 4 else "jointtarget", value)

    def involves_target(self, value: Node) -> bool:
        """Whether a value contains the name of a target."""
        return any(self.scope.type_of(node.text.lower()) in SHAPES for node in value.walk())


def _local_names(part: Node) -> Iterator[Node]:
    """Yield the names that a part of a routine declares: parameters or data."""
    if part.kind == "parameters":
        yield from (parameter.items[-1] or parameter.items[-2] for parameter in part.items)
    elif part.kind == "inner_data":
        yield from (item.items[0] for item in part.items[0].items if item is not None and item.kind == "variable")


def _indexed(name: str, k: int) -> str:
    return f"{name[:-1]},{k}}}" if name.endswith("}") else f"{name}{{{k}}}"
