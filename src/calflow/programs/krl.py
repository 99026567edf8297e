"""KRL: programs of KUKA robots, modules (.src) and data lists (.dat), by the KRL reference guide."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOTATIONS, NOWHERE
from calflow.files.problems import refuse
from calflow.programs.names import GLOBAL, Call, root
from calflow.programs.statements import INDIRECT, STATIONARY, Destination, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaves
from calflow.programs.target import Declaration, External, Flag, KrlConfiguration, Skipped, Target, Use

POSE_TYPES, AXIS_TYPES = ("POS", "E3POS", "E6POS", "FRAME"), ("AXIS", "E3AXIS", "E6AXIS")
NOTATION = NOTATIONS["krl"]
COMPONENTS, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = tuple(f"E{k}" for k in range(1, 7))
SUFFIXES = (".src", ".dat", ".sub")
BEGINS = re.compile(r"(?:\xef\xbb\xbf)?(?:\s|;[^\r\n]*|&[^\r\n]*)*(?:GLOBAL\s+)?(?:DEF|DEFFCT|DEFDAT)\s", re.IGNORECASE)
NAMES_AND_VALUES = re.compile(r'#[ \t]*[\w$]+|"[^"\n]*"|[A-Za-z]\w*(?:\[\])?|[-+.\d][-+.\dEe]*')  # alternate
KINDS_BY_SIGN = {"#": "computed", '"': "string"}  # of values other than numbers, by their first character
TABLES = ("TOOL_DATA[", "BASE_DATA[")
CONFIGURATION = "$CONFIG"  # the data list whose names are global
MOVE_DATA_FUNCTIONS = ("STOOL", "STOOL2", "SBASE")  # the tool and base of move data
NULL_FRAME, WORLD = "$NULLFRAME", "$WORLD"


class _Builder(TreeBuilder):
    """KRL's aggregates `{TYPE: NAME value, ...}`: lists of keywords with the type as text."""

    def aggregate(self, children: Sequence[Any]) -> Node:
        """An aggregate with distinct components."""
        first, kind, *items, last = children
        if len({item.text for item in items}) < len(items):
            again = next(item for k, item in enumerate(items) if item.text in {before.text for before in items[:k]})
            raise refuse(f"{again.text} is given twice", line=again.line)
        return branch("list", kind.upper() if kind else "", first, last, items)

    def member(self, children: Sequence[Any]) -> Node:
        """NAME value, or NAME[2] value, of an aggregate."""
        name, index, value = children
        spelled = self.name([name, *([index] if index else [])]).text
        return branch("keyword", spelled.upper(), name, value, [value])

    def flat(self, children: Sequence[Any]) -> Node:
        """An aggregate that is one token."""
        parts = iter(leaves(children[0], NAMES_AND_VALUES))
        items = [
            Node(
                "keyword", name.text.upper(), name.start, value.end, name.line,
                (value._replace(kind=KINDS_BY_SIGN.get(value.text[0], "number")),), 1,
            )
            for name, value in zip(parts, parts, strict=True)
        ]  # fmt: skip
        return self.aggregate([children[0], None, *items, children[0]])


def krl_target(name: str, kind: str, value: Node) -> Target | Skipped:
    """Return the target of an aggregate of a type, or why it is skipped.

    Raises:
        InputError: it has components that the type does not have.
    """
    if value.kind != "list":
        return Skipped(name, value.line, "computed", "is computed")
    given = {item.text: item.items[0] for item in value.items}
    wanted = JOINTS if kind in AXIS_TYPES else COMPONENTS
    allowed = {*wanted, *EXTERNAL} | ({"S", "T"} if kind not in ("FRAME", *AXIS_TYPES) else set())
    odd = [item for item in value.items if item.text not in allowed]
    if odd:
        raise refuse(f"{name}: a {kind} has no component {odd[0].text}", line=odd[0].line)
    if lacking := ", ".join(name for name in wanted if name not in given):
        return Skipped(name, value.line, "incomplete", f"does not give {lacking}: the robot keeps the values before")
    if any(given[name].kind != "number" for name in wanted):
        return Skipped(name, value.line, "computed", "is computed")
    axes = {
        k: given[axis] for k, axis in enumerate(EXTERNAL, start=1) if axis in given and given[axis].kind == "number"
    }
    external = {k: External(float(item.text)) for k, item in axes.items()}
    if kind in AXIS_TYPES:
        joints = tuple(given[name].number(np.pi / 180) for name in wanted)
        return Target(name, value.line, joints, None, external=external)
    numbers = tuple(given[name].number(scale) for name, scale in zip(wanted, NOTATION.scales, strict=True))
    configuration = _configuration(name, [(name, given[name]) for name in ("S", "T") if name in given])
    return Target(name, value.line, numbers, NOTATION.turn, configuration, external=external)


def _configuration(name: str, flags: list[tuple[str, Node]]) -> KrlConfiguration | None:
    """The configuration of S and T, numbers or bits."""
    for flag, value in flags:
        if re.fullmatch(r"\d+|'[Bb][01]+'", value.text) is None:
            raise refuse(f"{name}: expected a whole number or bits such as 'B010' as {flag}", line=value.line)
    if not flags:
        return None
    places = tuple(Flag(value.start, value.end, value.text) for _, value in flags)
    return KrlConfiguration(places, tuple(name for name, _ in flags))


def frame(value: Node) -> np.ndarray | None:
    """{X 1, Y 2, Z 3, A 0, B 0, C 0} as a transform; None unless all are numbers."""
    given = {item.text: item.items[0] for item in value.items} if value.kind == "list" else {}
    if any(name not in given or given[name].kind != "number" for name in COMPONENTS):
        return None
    return NOTATION.pose([float(given[name].text) for name in COMPONENTS])


def krl_number(name: str) -> str:
    """The number 1 of TOOL_DATA[1] or BASE_DATA[1]; other names unchanged."""
    match = re.fullmatch(r"(?:TOOL|BASE)_DATA\[(\d+)\]", name)
    return match.group(1) if match else name


@dataclass
class KrlFile(Statements):
    """A module or a data list."""

    stated: dict[str, np.ndarray] = field(default_factory=dict)  # values of $TOOL and $BASE, by label
    move_targets: set[str] = field(default_factory=set)  # names of targets of moves
    routine: str = ""  # the one being read
    data: bool = False  # whether it is a data list
    public: bool = False  # whether its names are global

    maker, flange, base, remark, number_types = "krl", "0", "0", ";", ("REAL", "INT")
    grammar = Grammar("expressions", "krl", builder=_Builder())

    @property
    def group(self) -> str:
        """The module to which the file or its data list belongs."""
        return self.file.rpartition(".")[0].lower()

    @staticmethod
    def folded(name: str) -> str:
        """Return a name in upper case, as KRL ignores case."""
        return name.upper()

    def read_routine(self, node: Node) -> None:
        """DEF name( ) ... END, or DEFFCT type name( ) ... ENDFCT, or DEFDAT name ... ENDDAT"""
        self.data = node.kind == "data_list"
        self.routine = [item.text for item in node.items if item and item.kind == "token"][-1].upper()
        self.public = self.data and self.routine == CONFIGURATION
        if not self.data:
            node = self.with_local_names(self.routine, {*_parameters(node), *_declared(node)}, node)
            self.symbols.parameters[self.routine] = _parameters(node)
            self.symbols.private |= {*_parameters(node)}
        self.defer(self.activate, Use())
        self.read_items(node)

    read_data_list = read_routine

    def read_list(self, node: Node) -> None:
        """An aggregate in an expression, possibly a literal target."""
        if {item.text for item in node.items} >= {*COMPONENTS, "S", "T"}:
            self.literals.append(node)
        else:
            self.read_items(node)

    def read_relative(self, node: Node) -> None:
        """PTP_REL, LIN_REL, CIRC_REL, SPL_REL."""
        word = node.items[0].text.upper()
        self.skip(f"{word} in line {node.line}", node.line, "relative", "is relative to the current position")

    def read_declaration(self, node: Node) -> None:
        """DECL GLOBAL CONST type name[3], name = value"""
        self.read_items(node)
        words = {item.text.upper() for item in node.items if item.kind == "token"}
        kind, *variables = (item for item in node.items if item.kind != "token")
        for name, value in (variable.items for variable in variables):
            self.declare(root(kind.text).upper(), name, value, "GLOBAL" in words, "CONST" in words)
            if value:
                self.defer(self.assign_value, name, value, node.start, node.end)

    def declare(self, kind: str, name: Node, value: Node | None, shared: bool, constant: bool) -> None:
        """Record the type of a name, and its value unless statements may count it up."""
        variable = root(name.text).upper()
        self.symbols.types[variable] = kind
        if not (shared or self.public):
            self.symbols.private.add(variable)
        if value and (constant or kind not in self.number_types):
            self.symbols.values[self.key(name.text)].append(value)

    def read_assignment(self, node: Node) -> None:
        """name = value"""
        to, value = node.items
        whole = self.add_assignment(node)
        if whole in ("$TOOL", "$BASE", "FDAT_ACT"):
            self.symbols.frame_setters.add(self.routine)
            self.symbols.private.add(f"{whole} of line {value.line}")
        self.defer(self.assign_value, to, value, to.start if self.data else None, value.end)

    def read_statement(self, node: Node) -> None:
        """A line, possibly a call."""
        (first, *_) = node.items
        if first.kind == "call":
            if _sets_frame(first):
                self.symbols.frame_setters.add(self.routine)
            elif self.key(first.text) != "BAS":
                self.symbols.calls.append(Call(self.routine, self.key(first.text), first.items))
            self.defer(self.apply_call, first)
        self.read(first)

    def assign_value(self, to: Node, value: Node, start: int | None, end: int) -> None:
        """Record an assignment; start, end: bytes of a declaration in a data list."""
        name = self.key(to.text)
        kind = self.scope.type_of(root(name))
        spelled = {item.text for item in value.items} if value.kind == "list" else set()
        if name in ("$TOOL", "$BASE"):
            self.active = self.with_frame(self.active, name, value)
        elif name == "FDAT_ACT" and value.kind == "name":
            self.active = self.move_data(self.key(value.text)) or Use()
        elif name.startswith(TABLES) or kind == "FDAT":
            pass
        elif kind in (*POSE_TYPES, *AXIS_TYPES):
            if "." in name:
                why = "changes a part of a target on the way: the result is unknown"
                self.skip(to.text, to.line, "changed on the way", why)
            else:
                words = "DECL GLOBAL" if self.shared(root(name)) else "DECL"
                declared = None if start is None else self.declaration(start, f"{words} {kind} ", name, value, end)
                self.add_point(to.text, kind, value, declared)
        elif kind == "" and value.kind == "list" and value.text in (*POSE_TYPES, *AXIS_TYPES):
            self.add_point(to.text, value.text, value)
        elif kind == "" and spelled >= {*COMPONENTS, "S", "T"}:
            self.add_point(to.text, "E6POS", value)
        elif spelled >= {*COMPONENTS}:
            what = f"is a {kind}" if kind else "is not declared in this file"
            self.skip(to.text, to.line, "no move" if kind else "elsewhere", f"looks like a target, but {what}")

    def with_frame(self, use: Use, name: str, value: Node) -> Use:
        """Return a tool and base with a new value of $TOOL or $BASE."""
        here = f"{name} of line {value.line}"
        known: str | None = here
        if value.kind == "name":
            known = "0" if self.key(value.text) in (NULL_FRAME, WORLD) else krl_number(self.key(value.text))
        elif value.kind == "call" and self.key(value.text) in MOVE_DATA_FUNCTIONS and value.items:
            data = self.move_data(self.key(value.items[0].text).partition(".")[0])
            known = here if data is None else data.tool if name == "$TOOL" else data.frame
        elif (matrix := self.frame_of(value)) is not None:
            self.stated[here] = matrix
        return replace(use, tool=known) if name == "$TOOL" else replace(use, frame=known)

    def apply_call(self, call: Node) -> None:
        """Apply BAS(#TOOL, 1) or BAS(#BASE, 1); after other routines that set them, tool and base are unknown."""
        if _sets_frame(call):
            what, number = call.items[0].text.upper(), call.items[1].text
            self.active = replace(self.active, tool=number) if what == "#TOOL" else replace(self.active, frame=number)
        elif self.key(call.text) in self.scope.project.frame_setters:
            self.active = Use()

    def read_motion(self, node: Node) -> None:
        """PTP target C_PTP, LIN target, CIRC target, target, CA 90; then the rest of the line."""
        move, *places, further = node.items
        for k, place in enumerate(places):
            if place.kind == "list" and _literal_kind(place) not in (*POSE_TYPES, *AXIS_TYPES):
                raise refuse(f"expected a target, found a {_literal_kind(place)}", line=place.line)
            self.move_targets |= {self.key(place.text)} if place.kind == "name" else set()
            name = f"{move.text.upper()} in line {node.line}" + (", end" if k else "")
            self.defer(self.move, place, name, node.line, further)
        self.read_items(node)

    def read_spline(self, node: Node) -> None:
        """SPLINE WITH $TOOL = value, ... moves ENDSPLINE"""
        before = list[Use]()
        self.defer(lambda: before.append(self.active))
        self.defer(lambda: self.activate(self.with_settings(node.items[1])))
        self.read_items(node)
        self.defer(lambda: self.activate(before.pop()))

    def with_settings(self, further: Node) -> Use:
        """Return tool and base of a move with settings of its own: WITH $TOOL = value, $BASE = value."""
        use = self.active
        for to, value in (item.items for item in further.items if item and item.kind == "setting"):
            if to.text.upper() in ("$TOOL", "$BASE"):
                use = self.with_frame(use, to.text.upper(), value)
        return use

    def move(self, value: Node, name: str, line: int, further: Node) -> None:
        """Record a move."""
        use = self.with_settings(further)
        self.add_move(self.destination(value), value, value.text if value.kind == "name" else name, line, use)

    def is_literal(self, value: Node) -> bool:
        """Whether a value in a move is a literal target."""
        return value.kind == "list"

    def target(self, name: str, value: Node) -> Target | Skipped:
        """The target of an aggregate in a move."""
        return krl_target(name, _literal_kind(value), value)

    def composed(self, value: Node, depth: int) -> Destination | None:
        """The destination that `:` computes from a target and known frames."""
        if value.kind != "operation" or set(value.text.split()) != {":"}:
            return None
        points = [k for k, item in enumerate(value.items) if self.is_point(item)]
        if points != [0] and points != [len(value.items) - 1]:
            return None
        origin = self.destination(value.items[points[0]], depth)
        others = [self.frame_of(item) for k, item in enumerate(value.items) if k != points[0]]
        if origin is None or (points != [0] and any(other is None for other in others)):
            return None
        for frame_before in reversed(others) if points != [0] else ():
            origin = origin.transformed(frame_before, NOWHERE)
        for frame_after in others if points == [0] else ():
            origin = origin.transformed(NOWHERE, frame_after)
        return origin

    def is_point(self, value: Node) -> bool:
        """Whether a value is a target rather than a frame."""
        if value.kind == "list":
            return {"S", "T"} <= {item.text for item in value.items}
        return self.scope.type_of(self.key(value.text)) in ("POS", "E3POS", "E6POS")

    def frame_of(self, value: Node) -> np.ndarray | None:
        """The pose (4, 4) of an aggregate, of a name that no move uses, or of their product `:`; None if unknown."""
        if value.kind == "operation" and set(value.text.split()) == {":"}:
            frames = [part for part in map(self.frame_of, value.items) if part is not None]
            return np.linalg.multi_dot(frames) if len(frames) == len(value.items) else None
        is_target = value.kind == "name" and self.key(value.text) in self.move_targets
        value_of = None if is_target else self.scope.value(self.key(value.text)) if value.kind == "name" else value
        return None if value_of is None else frame(value_of)

    def shared(self, name: str) -> bool:
        """Whether a name is global although its data list is not."""
        return not self.public and self.scope.owner(name) == GLOBAL

    def add_point(self, name: str, kind: str, value: Node, declared: Declaration | None = None) -> None:
        """Record the target of a name, or why it is skipped."""
        if value.kind in INDIRECT and self.destination(value) is not None:
            return
        use = self.move_data("F" + self.key(name)[1:]) if self.key(name).startswith("X") else None
        unused = Skipped(name, value.line, "no move", "is a FRAME that no move of this file uses")
        if_unused = unused if kind == "FRAME" else None
        self.add_target(krl_target(name, kind, value), defaults=use, if_unused=if_unused, declared=declared)

    def move_data(self, name: str) -> Use | None:
        """Tool and base of move data, an FDAT; None if no file defines it."""
        data = self.scope.value(name)
        if data is None or data.kind != "list":
            return None
        given = {item.text: item.items[0] for item in data.items}
        if "IPO_FRAME" in given and given["IPO_FRAME"].text.upper() == "#TCP":
            return Use(STATIONARY)
        tool, base = (
            given[name].text if name in given and given[name].kind == "number" else None
            for name in ("TOOL_NO", "BASE_NO")
        )
        return Use(tool, base)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield tools and bases by number, and the values of $TOOL and $BASE."""
        for name, stated in self.stated.items():
            yield "tool" if name.startswith("$TOOL") else "frame", self.scope.label(name), stated
        for name in self.symbols.values:
            if name.startswith(TABLES) and name.endswith("]"):
                value = self.scope.value(name)
                matrix = None if value is None else frame(value)
                yield "tool" if name.startswith("TOOL") else "frame", self.scope.label(krl_number(name)), matrix


def _parameters(routine: Node) -> list[str]:
    """The parameters of a routine."""
    lists = (item for item in routine.items if item and item.kind == "parameters")
    return [parameter.items[0].text.upper() for each in lists for parameter in each.items if parameter]


def _declared(routine: Node) -> Iterator[str]:
    """The local variables of a routine."""
    for statement in (item.items[0] for item in routine.items if item and item.kind == "statement"):
        if statement.kind == "declaration":
            yield from (root(item.items[0].text).upper() for item in statement.items if item.kind == "variable")


def _sets_frame(call: Node) -> bool:
    """Whether a call is BAS(#TOOL, 1) or BAS(#BASE, 1)."""
    basic = call.text.upper() == "BAS" and len(call.items) == 2 and call.items[1].kind == "number"
    return basic and call.items[0].text.upper() in ("#TOOL", "#BASE")


def _literal_kind(value: Node) -> str:
    """The type of an aggregate in a move."""
    return value.text or ("E6AXIS" if any(item.text in JOINTS for item in value.items) else "E6POS")
