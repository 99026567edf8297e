"""RAPID: programs of ABB robots, read after the RAPID reference manual's grammar of modules, data and routines.

RAPID's values: its expressions, and targets, tools and work objects as it writes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOWHERE, pose_matrix
from calflow.files.deferred import Rotation
from calflow.programs.names import ALIAS, Call
from calflow.programs.statements import FOLLOWED, Place, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder, refusal
from calflow.programs.target import External, Flag, Left, Number, RapidConfiguration, Target, Use

UNIT_LENGTH = 1e-3  # by how much a quaternion's length may differ from 1, as the maker allows
EXTERNAL = 6  # values of external axes that a target has
# How many values stand in the lists of a target.
SHAPES = {"robtarget": [3, 4, 4, EXTERNAL], "jointtarget": [6, EXTERNAL]}
PLACEHOLDER = 9e9
NOT_THERE = 8.9e9  # an external axis that there is not has 9E9
SUFFIXES = (".mod", ".modx", ".sys", ".sysx", ".prg")
BEGINS = re.compile(r"(?:\xef\xbb\xbf)?(?:\s|![^\r\n]*|%%%[^%]*%%%)*MODULE\s", re.IGNORECASE)
# How many targets come first.
PLACES_AT = {"MOVEJ": 1, "MOVEL": 1, "MOVEABSJ": 1, "MOVEC": 2}
JOINTWISE = re.compile("(?:MOVE|TRIGG|PAINT|ARC|SPOT)J")
MOVING = ("MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "DISP", "PAINT", "CALIB")
DISPLACING = ("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET")


def rapid_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the robtarget or jointtarget that a value states, or why it is left alone.

    Raises:
        InputError: it has not the shape of one.
    """
    computed = Left(name, value.line, "computed", "is computed")
    if value.kind != "list":
        return computed
    sizes = SHAPES[kind]
    groups = value.items
    if len(groups) == len(sizes) and any(group.kind != "list" for group in groups):
        return computed
    if _shape(value) != sizes:
        shape = ", ".join(f"[{size}]" for size in sizes)
        raise refusal(f"{name}: expected a {kind} of {len(sizes)} lists with {shape} values", value.line)
    if any(item.kind != "number" for group in groups for item in group.items):
        return computed
    if any(float(item.text) == PLACEHOLDER for group in groups[:-1] for item in group.items):
        return Left(name, value.line, "never taught", "has 9E9 in the place of a number")
    axes = {k: External(float(item.text)) for k, item in enumerate(groups[-1].items, start=1)}
    external = {k: axis for k, axis in axes.items() if abs(axis.value) < NOT_THERE}
    if kind == "jointtarget":
        joints = tuple(_number(item, np.pi / 180) for item in groups[0].items)
        return Target(name, value.line, joints, None, external=external)
    for item in groups[2].items:
        if re.fullmatch(r"[+-]?\d+(?:\.0*)?(?:[eE][+]?0+)?", item.text) is None:
            raise refusal(f"{name}: expected a whole number in its configuration, found '{item.text}'", item.line)
    flags = tuple(Flag(item.start, item.end, str(int(float(item.text)))) for item in groups[2].items)
    place = [_number(item, 1e-3) for item in groups[0].items]
    turn = [_number(item, 1.0) for item in groups[1].items]
    return Target(name, value.line, (*place, *turn), "quaternion", RapidConfiguration(flags), external=external)


def _tool(value: Node) -> np.ndarray | None:
    """[TRUE, [[x, y, z], [q1, q2, q3, q4]], [load]] as a transform; None for a tool that does not move with the robot."""
    if len(value.items) != 3 or value.items[0].text.upper() != "TRUE":
        return None
    return _pose(value.items[1])


def _work_object(value: Node) -> np.ndarray | None:
    """[FALSE, TRUE, "", user frame, object frame] as a transform; None for one that moves."""
    if len(value.items) != 5 or [item.text.upper() for item in value.items[:3]] != ["FALSE", "TRUE", '""']:
        return None
    user, object_frame = _pose(value.items[3]), _pose(value.items[4])
    return None if user is None or object_frame is None else user @ object_frame


def _pose(value: Node) -> np.ndarray | None:
    """[[x, y, z], [q1, q2, q3, q4]] as a transform; None where it is not made of numbers."""
    if [len(item.items) for item in value.items] != [3, 4]:
        return None
    items = [item for group in value.items for item in group.items]
    if any(item.kind != "number" for item in items):
        return None
    scales = (1e-3,) * 3 + (1.0,) * 4
    values = np.array([_number(item, scale).value for item, scale in zip(items, scales, strict=True)])
    usual = np.isfinite(values).all() and abs(np.linalg.norm(values[3:]) - 1) < UNIT_LENGTH
    return pose_matrix(values, "quaternion") if usual else None


def _shape(value: Node) -> list[int]:
    """How many values stand in each of the lists of a value."""
    return [len(group.items) for group in value.items]


def _number(item: Node, scale: float) -> Number:
    text = item.text if item.text[1:2].lower() not in ("x", "b", "o") else str(int(item.text, 0))
    return Number(item.start, item.end, text, scale)


class _Builder(TreeBuilder):
    """RAPID's names have their indices in braces, and arguments are passed on."""

    brackets = ("{", "}")

    def passed(self, children: Sequence[Any]) -> Node:
        """An argument with which the routine was itself called, if it was: \\Option?parameter."""
        name, value = children
        return self.keyword([name, value._replace(text=f"?{value.text}")])


@dataclass
class RapidModules(Statements):
    """What is gathered on the way through a file of modules.

    unwatched has ConfL and ConfJ, where the file switches them off; which moves come after that, only its run would tell.
    """

    unwatched: set[str] = field(default_factory=set)

    maker, flange, base = "rapid", "tool0", "wobj0"
    sign, remark, counted = ":=", "!", ("num",)
    grammar = Grammar("expressions", "rapid", builder=_Builder())

    @staticmethod
    def folded(name: str) -> str:
        """Return a name in lower case."""
        return name.lower()

    def read_data(self, node: Node, inside: bool = False) -> None:
        """LOCAL VAR type name {dimensions} := value, ...; private to the file inside a routine too."""
        self.read_items(node)
        scope, storage, kind_token, *variables, _ = node.items
        kind, head = kind_token.text.lower(), self.source[node.start : kind_token.start].decode("latin-1")
        constant = storage.text.upper() == "CONST"
        for name, shape, value in (variable.items for variable in variables):
            self.declare(name.text, kind, inside or (scope is not None and scope.text.upper() == "LOCAL"))
            dimensions = len(shape.items) if shape else 0
            if constant and value is None:
                raise refusal(f"expected a value of the constant {name.text}", name.line)
            if value is not None:
                if constant or kind not in self.counted:
                    self.value_of(name.text.lower(), dimensions, value)
                self.later(self.given, name.text, kind, dimensions, value, (node.start, head, node.end))

    def read_inner_data(self, node: Node) -> None:
        """Data of a routine."""
        self.read_data(node.items[0], inside=True)

    def declare(self, name: str, kind: str, private: bool) -> None:
        """Take a name's type."""
        self.declared.types[name.lower()] = kind
        if private:
            self.declared.private.add(name.lower())

    def value_of(self, name: str, dimensions: int, value: Node) -> None:
        """Take the value that a name, or each place of an array, begins with."""
        if not dimensions:
            self.declared.values[name].append(value)
        elif value.kind == "list":
            for k, item in enumerate(value.items, start=1):
                self.value_of(_indexed(name, k), dimensions - 1, item)

    def given(
        self, name: str, kind: str, dimensions: int, value: Node, stands: tuple[int, str, int] | None = None
    ) -> None:
        """Take what is given to a name: a target, or an array or a record of such; stands: where a declaration does, its head."""
        kind = self.scope.resolved(kind)
        if dimensions and value.kind == "list":
            for k, item in enumerate(value.items, start=1):
                self.given(_indexed(name, k), kind, dimensions - 1, item, stands)
        elif kind in SHAPES and (dimensions or value.kind not in FOLLOWED or self.place(value) is None):
            found = Left(name, value.line, "computed", "is computed") if dimensions else rapid_target(name, kind, value)
            declared = None
            if stands:
                start, head, end = stands
                declared = self.declared_as(start, f"{head}{kind} ", name, value, end, ";")
            self.take(found, declared=declared)
        elif kind in self.scope.project.components and value.kind == "list":
            for (part, inner), item in zip(self.scope.project.components[kind].items(), value.items, strict=False):
                self.given(f"{name}.{part}", inner, 0, item, stands)
        elif kind not in SHAPES and _shape(value) in SHAPES.values():
            self.leave(name, value.line, "no move", f"reads like a target, and is a {kind}")

    def read_record(self, node: Node) -> None:
        """RECORD name type component; ... ENDRECORD"""
        name, *members = node.items
        for kind, member in (member.items for member in members):
            self.declared.components[name.text.lower()][member.text.lower()] = kind.text.lower()

    def read_alias(self, node: Node) -> None:
        """ALIAS type name;"""
        kind, name = node.items
        self.declared.components[name.text.lower()][ALIAS] = kind.text.lower()

    def read_routine(self, node: Node) -> None:
        """PROC name(parameters) ... ENDPROC and the like."""
        names = [item.text.lower() for item in node.items if item is not None and item.kind == "token"]
        own = {name.text.lower() for item in node.items if item is not None for name in _own_names(item)}
        node = self.with_names_of(names[-1], own, node)
        for parameters in (item for item in node.items if item is not None and item.kind == "parameters"):
            self.declared.parameters[names[-1]] = [
                parameter.items[-1].text.lower()
                for parameter in parameters.items
                if len(parameter.items) == 2 and parameter.items[-1]
            ]
        self.read_items(node)

    def read_parameter(self, node: Node) -> None:
        """type name, of a routine; a switch need not have a type."""
        *_, kind, name = node.items
        if name is not None:
            self.declare(name.text, kind.text.lower(), private=True)

    def read_list(self, node: Node) -> None:
        """Values in an expression, which may be those of a target."""
        if _shape(node) in SHAPES.values():
            self.literals.append(node)
        else:
            self.read_items(node)

    def read_instruction(self, node: Node) -> None:
        """Instruction a, b \\Option:=c; or of one argument, in brackets."""
        self.read_items(node)
        name, given = node.items
        arguments = given.items if given is not None else name.items if name.kind == "call" else ()
        switched = name.text.upper()
        if switched in ("CONFL", "CONFJ") and "OFF" in {argument.text.upper() for argument in arguments}:
            self.unwatched.add(switched)
        given_always = [item for item in arguments if item.kind != "keyword"]
        self.declared.calls.append(Call("", name.text.lower(), given_always))
        self.later(self.move, name, arguments)

    def read_assignment(self, node: Node) -> None:
        """name := value;"""
        self.assigned(node)
        self.later(self.assign, *node.items)

    def assign(self, to: Node, value: Node) -> None:
        """Take a target that a routine gives to a name."""
        kind, whole = self.scope.type_of(to.text.lower()), to.text.rpartition(".")
        if kind in SHAPES:
            self.given(to.text, kind, 0, value)
        elif any(self.scope.type_of(part) in SHAPES for part in _wholes(whole[0].lower())):
            why = f"changes {to.text.partition('.')[2]} of a target on the way: what it makes of it is not known"
            self.leave(to.text, to.line, "changed on the way", why)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield tools and work objects that are stated once, by numbers; what else there is of them is left to the user."""
        for name, values in self.declared.values.items():
            kind = self.scope.type_of(name)
            if kind not in ("tooldata", "wobjdata"):
                continue
            value = self.scope.value(name)
            matrix = None if value is None else _tool(value) if kind == "tooldata" else _work_object(value)
            if matrix is None:
                unusual = "is not stated by numbers alone, not held as usual, or has no quaternion of length 1"
                why = "is set more than once" if value is None else unusual
                self.leave(name, values[0].line, "tool or frame", why)
            yield "tool" if kind == "tooldata" else "frame", self.scope.label(name), matrix

    def move(self, name: Node, arguments: Iterable[Node]) -> None:
        """Take what an instruction says of the targets that it names."""
        instruction = name.text.upper()
        whole = Node("call", name.text, name.start, name.end, name.line, tuple(arguments))
        places = whole.arguments
        if instruction in DISPLACING:
            self.leave(name.text, name.line, "shared", "displaces what follows: it is corrected as if it did not")
        if not instruction.startswith(MOVING):
            return
        at = 4 if instruction.startswith("MOVEC") else 3 if instruction.startswith("MOVE") else len(places) - 1
        tool = places[at].text if 0 <= at < len(places) and places[at].kind == "name" else ""
        frame = whole.keyword("wobj")
        watched = ("CONFJ" if JOINTWISE.match(instruction) else "CONFL") not in self.unwatched
        use = Use(self.meant(tool), self.meant(frame.text if frame else self.base), flagged=watched)
        for k, value in enumerate(places):
            if instruction.startswith("SEARCH") and k == 1:  # the place that it finds
                continue
            if k < PLACES_AT.get(instruction, 0) or self.is_literal(value) or self.of_point(value):
                named = {"name": value.text, "call": f"{value.text}(…)"}.get(value.kind, f"target in line {value.line}")
                self.go_to(self.place(value), value, named, value.line, use)

    def composed(self, value: Node, depth: int) -> Place | None:
        """What Offs or RelTool make of a target."""
        if value.kind != "call" or not value.items:
            return None
        function = value.text.upper()
        inner = self.place(value.items[0], depth) if function in ("OFFS", "RELTOOL") else None
        if inner is None:
            origin = next((item for item in value.items if self.of_point(item)), None)
            return None if origin is None else Place(origin, None, None)
        numbers = [self.number(item) for item in value.arguments[1:4]]
        turns = [value.keyword(axis) for axis in ("rx", "ry", "rz")]
        angles = [0.0 if turn is None else self.number(turn) for turn in turns]
        if len(numbers) < 3 or None in (*numbers, *angles):
            return inner.moved(None, None)
        shift = np.eye(4)
        shift[:3, 3] = 1e-3 * np.array(numbers, dtype=float)
        if function == "OFFS":
            return inner.moved(shift, NOWHERE)
        shift[:3, :3] = Rotation.from_euler("XYZ", np.array(angles, dtype=float), degrees=True).as_matrix()
        return inner.moved(NOWHERE, shift)

    def is_literal(self, value: Node) -> bool:
        """Whether a value in a move has the shape of a target."""
        return value.kind == "list" and len(value.items) in (2, 4) and all(item.kind == "list" for item in value.items)

    def target(self, name: str, value: Node) -> Target | Left:
        """The target that a value in a move states."""
        return rapid_target(name, "robtarget" if len(value.items) == 4 else "jointtarget", value)

    def of_point(self, value: Node) -> bool:
        """Whether a value is a target's name, or has one in it."""
        return any(self.scope.type_of(node.text.lower()) in SHAPES for node in value.walk())


def _own_names(part: Node) -> Iterator[Node]:
    """The names that a part of a routine declares: of parameters, or of data."""
    if part.kind == "parameters":
        yield from (parameter.items[-1] or parameter.items[-2] for parameter in part.items)
    elif part.kind == "inner_data":
        yield from (item.items[0] for item in part.items[0].items if item is not None and item.kind == "variable")


def _indexed(name: str, k: int) -> str:
    return f"{name[:-1]},{k}}}" if name.endswith("}") else f"{name}{{{k}}}"


def _wholes(name: str) -> Iterator[str]:
    """A name of components, and all that it is a part of."""
    while name:
        yield name
        name = name.rpartition(".")[0]
