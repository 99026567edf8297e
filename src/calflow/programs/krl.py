"""KRL: programs of KUKA robots, module (.src) and data list (.dat), read after the KRL reference guide, a statement a line.

KRL's values: its expressions with aggregates, and targets and frames as it writes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOWHERE, pose_matrix
from calflow.programs.names import SHARED, Call, root
from calflow.programs.statements import FOLLOWED, STANDING, Place, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaves, refusal
from calflow.programs.target import Declaration, External, Flag, KrlConfiguration, Left, Number, Target, Use

POSE_TYPES, AXIS_TYPES = ("POS", "E3POS", "E6POS", "FRAME"), ("AXIS", "E3AXIS", "E6AXIS")
PLACE, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = tuple(f"E{k}" for k in range(1, 7))
SUFFIXES = (".src", ".dat", ".sub")
BEGINS = re.compile(r"(?:\xef\xbb\xbf)?(?:\s|;[^\r\n]*|&[^\r\n]*)*(?:GLOBAL\s+)?(?:DEF|DEFFCT|DEFDAT)\s", re.IGNORECASE)
NAMES_AND_VALUES = re.compile(
    r'#[ \t]*[\w$]+|"[^"\n]*"|[A-Za-z]\w*(?:\[\])?|[-+.\d][-+.\dEe]*'
)  # names and values by turns
KINDS_BY_SIGN = {"#": "computed", '"': "string"}  # of values that are no numbers, by how they begin
TABLES = ("TOOL_DATA[", "BASE_DATA[")
CONFIGURATION = "$CONFIG"  # the data list whose names all files see
OF_MOVE_DATA = ("STOOL", "STOOL2", "SBASE")  # the tool and the base of move data
NULL_FRAME, WORLD = "$NULLFRAME", "$WORLD"


class _Builder(TreeBuilder):
    """KRL's aggregates `{TYPE: NAME value, ...}`: lists of keywords, whose text is the type."""

    def aggregate(self, children: Sequence[Any]) -> Node:
        """An aggregate, in which no component is given twice."""
        first, kind, *items, last = children
        if len({item.text for item in items}) < len(items):
            again = next(item for k, item in enumerate(items) if item.text in {before.text for before in items[:k]})
            raise refusal(f"{again.text} is given twice", again.line)
        return branch("list", kind.upper() if kind else "", first, last, items)

    def member(self, children: Sequence[Any]) -> Node:
        """NAME value, or NAME[2] value, of an aggregate."""
        name, index, value = children
        spelled = self.name([name, *([index] if index else [])]).text
        return branch("keyword", spelled.upper(), name, value, [value])

    def flat(self, children: Sequence[Any]) -> Node:
        """An aggregate of numbers, words and texts."""
        parts = iter(leaves(children[0], NAMES_AND_VALUES))
        items = [
            Node(
                "keyword", name.text.upper(), name.start, value.end, name.line,
                (value._replace(kind=KINDS_BY_SIGN.get(value.text[0], "number")),), 1,
            )
            for name, value in zip(parts, parts, strict=True)
        ]  # fmt: skip
        return self.aggregate([children[0], None, *items, children[0]])


def krl_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the target that an aggregate of a type states, or why it is left alone.

    Raises:
        InputError: it has components that the type has not.
    """
    if value.kind != "list":
        return Left(name, value.line, "computed", "is computed")
    given = {item.text: item.items[0] for item in value.items}
    wanted = JOINTS if kind in AXIS_TYPES else PLACE
    allowed = {*wanted, *EXTERNAL} | ({"S", "T"} if kind not in ("FRAME", *AXIS_TYPES) else set())
    odd = [item for item in value.items if item.text not in allowed]
    if odd:
        raise refusal(f"{name}: a {kind} has no component {odd[0].text}", odd[0].line)
    lacking = [name for name in wanted if name not in given]
    if lacking:
        return Left(
            name, value.line, "incomplete", f"does not give {', '.join(lacking)}: the robot keeps what it has of them"
        )
    if any(given[name].kind != "number" for name in wanted):
        return Left(name, value.line, "computed", "is computed")
    axes = {
        k: given[axis] for k, axis in enumerate(EXTERNAL, start=1) if axis in given and given[axis].kind == "number"
    }
    external = {k: External(float(item.text)) for k, item in axes.items()}
    if kind in AXIS_TYPES:
        joints = tuple(_number(given[name], np.pi / 180) for name in wanted)
        return Target(name, value.line, joints, None, external=external)
    numbers = tuple(_number(given[name], 1e-3 if name in "XYZ" else np.pi / 180) for name in wanted)
    configuration = _configuration(name, [(name, given[name]) for name in ("S", "T") if name in given])
    return Target(name, value.line, numbers, "zyx", configuration, external=external)


def _configuration(name: str, flags: list[tuple[str, Node]]) -> KrlConfiguration | None:
    """S and T, as numbers or as bits."""
    for flag, value in flags:
        if re.fullmatch(r"\d+|'[Bb][01]+'", value.text) is None:
            raise refusal(f"{name}: expected a whole number or bits such as 'B010' as {flag}", value.line)
    if not flags:
        return None
    places = tuple(Flag(value.start, value.end, value.text) for _, value in flags)
    return KrlConfiguration(places, tuple(name for name, _ in flags))


def frame(value: Node) -> np.ndarray | None:
    """{X 1, Y 2, Z 3, A 0, B 0, C 0} as a transform; None where it is not made of numbers."""
    given = {item.text: item.items[0] for item in value.items} if value.kind == "list" else {}
    if any(name not in given or given[name].kind != "number" for name in PLACE):
        return None
    return pose_matrix([_number(given[name], 1e-3 if name in "XYZ" else np.pi / 180).value for name in PLACE], "zyx")


def krl_number(name: str) -> str:
    """TOOL_DATA[1] and BASE_DATA[1] as 1; others by their own name."""
    match = re.fullmatch(r"(?:TOOL|BASE)_DATA\[(\d+)\]", name)
    return match.group(1) if match else name


def _number(item: Node, scale: float) -> Number:
    return Number(item.start, item.end, item.text, scale)


@dataclass
class KrlFile(Statements):
    """What is gathered on the way through a module or a data list."""

    stated: dict[str, np.ndarray] = field(default_factory=dict)  # $TOOL and $BASE by what they are called
    gone: set[str] = field(default_factory=set)  # names to which moves go as they are
    routine: str = ""  # what is read
    data: bool = False  # whether it is a data list
    public: bool = False  # whether all files see what it declares

    maker, flange, base, remark, counted = "krl", "0", "0", ";", ("REAL", "INT")
    grammar = Grammar("expressions", "krl", builder=_Builder())

    @property
    def group(self) -> str:
        """A module and its data list are one."""
        return self.file.rpartition(".")[0].lower()

    @staticmethod
    def folded(name: str) -> str:
        """Return a name as KRL compares it."""
        return name.upper()

    def read_routine(self, node: Node) -> None:
        """DEF name( ) ... END, or DEFFCT type name( ) ... ENDFCT, or DEFDAT name ... ENDDAT"""
        self.data = node.kind == "data_list"
        self.routine = [item.text for item in node.items if item and item.kind == "token"][-1].upper()
        self.public = self.data and self.routine == CONFIGURATION
        if not self.data:
            node = self.with_names_of(self.routine, {*_parameters(node), *_declared(node)}, node)
            self.declared.parameters[self.routine] = _parameters(node)
            self.declared.private |= {*_parameters(node)}
        self.later(self.enter, Use())
        self.read_items(node)

    read_data_list = read_routine

    def read_list(self, node: Node) -> None:
        """An aggregate in an expression, which may be a target's."""
        if {item.text for item in node.items} >= {*PLACE, "S", "T"}:
            self.literals.append(node)
        else:
            self.read_items(node)

    def read_relative(self, node: Node) -> None:
        """PTP_REL and the like."""
        word = node.items[0].text.upper()
        self.leave(f"{word} in line {node.line}", node.line, "relative", "is relative to where the robot is")

    def read_declaration(self, node: Node) -> None:
        """DECL GLOBAL CONST type name[3], name = value"""
        self.read_items(node)
        words = {item.text.upper() for item in node.items if item.kind == "token"}
        kind, *variables = (item for item in node.items if item.kind != "token")
        for name, value in (variable.items for variable in variables):
            self.declare(root(kind.text).upper(), name, value, "GLOBAL" in words, "CONST" in words)
            if value:
                self.later(self.given, name, value, node.start, node.end)

    def declare(self, kind: str, name: Node, value: Node | None, shared: bool, constant: bool) -> None:
        """Take a name's type, and its value where nothing counts it on."""
        variable = root(name.text).upper()
        self.declared.types[variable] = kind
        if not (shared or self.public):
            self.declared.private.add(variable)
        if value and (constant or kind not in self.counted):
            self.declared.values[self.key(name.text)].append(value)

    def read_assignment(self, node: Node) -> None:
        """name = value"""
        to, value = node.items
        whole = self.assigned(node)
        if whole in ("$TOOL", "$BASE", "FDAT_ACT"):
            self.declared.setting.add(self.routine)
            self.declared.private.add(f"{whole} of line {value.line}")
        self.later(self.given, to, value, to.start if self.data else None, value.end)

    def read_statement(self, node: Node) -> None:
        """A line, of which a call may stand alone."""
        (first, *_) = node.items
        if first.kind == "call":
            if _in_force(first):
                self.declared.setting.add(self.routine)
            elif self.key(first.text) != "BAS":
                self.declared.calls.append(Call(self.routine, self.key(first.text), first.items))
            self.later(self.called, first)
        self.read(first)

    def given(self, to: Node, value: Node, start: int | None, end: int) -> None:
        """Take what is given to a name, in a data list from a byte start to an end."""
        name = self.key(to.text)
        kind = self.scope.type_of(root(name))
        spelled = {item.text for item in value.items} if value.kind == "list" else set()
        if name in ("$TOOL", "$BASE"):
            self.now = self.with_frame(self.now, name, value)
        elif name == "FDAT_ACT" and value.kind == "name":
            self.now = self.of_move_data(self.key(value.text)) or Use()
        elif name.startswith(TABLES) or kind == "FDAT":
            pass
        elif kind in (*POSE_TYPES, *AXIS_TYPES):
            if "." in name:
                why = "changes a part of a target on the way: what it makes of it is not known"
                self.leave(to.text, to.line, "changed on the way", why)
            else:
                words = "DECL GLOBAL" if self.shared(root(name)) else "DECL"
                declared = None if start is None else self.declared_as(start, f"{words} {kind} ", name, value, end)
                self.point(to.text, kind, value, declared)
        elif kind == "" and value.kind == "list" and value.text in (*POSE_TYPES, *AXIS_TYPES):
            self.point(to.text, value.text, value)
        elif kind == "" and spelled >= {*PLACE, "S", "T"}:
            self.point(to.text, "E6POS", value)
        elif spelled >= {*PLACE}:
            what = f"is a {kind}" if kind else "is not declared in this file"
            self.leave(to.text, to.line, "no move" if kind else "elsewhere", f"reads like a target, and {what}")

    def with_frame(self, use: Use, name: str, value: Node) -> Use:
        """Return a tool and a base with a new value of $TOOL or $BASE."""
        here = f"{name} of line {value.line}"
        known: str | None = here
        if value.kind == "name":
            known = "0" if self.key(value.text) in (NULL_FRAME, WORLD) else krl_number(self.key(value.text))
        elif value.kind == "call" and self.key(value.text) in OF_MOVE_DATA and value.items:
            data = self.of_move_data(self.key(value.items[0].text).partition(".")[0])
            known = here if data is None else data.tool if name == "$TOOL" else data.frame
        elif (matrix := self.frame_of(value)) is not None:
            self.stated[here] = matrix
        return replace(use, tool=known) if name == "$TOOL" else replace(use, frame=known)

    def called(self, call: Node) -> None:
        """BAS(#TOOL, 1) and BAS(#BASE, 1) set what is in force; other routines that do leave it unknown."""
        if _in_force(call):
            what, number = call.items[0].text.upper(), call.items[1].text
            self.now = replace(self.now, tool=number) if what == "#TOOL" else replace(self.now, frame=number)
        elif self.key(call.text) in self.scope.project.setting:
            self.now = Use()

    def read_motion(self, node: Node) -> None:
        """PTP target C_PTP, LIN target, CIRC target, target, CA 90; with the rest of the line."""
        move, *places, further = node.items
        for k, place in enumerate(places):
            if place.kind == "list" and _literal_kind(place) not in (*POSE_TYPES, *AXIS_TYPES):
                raise refusal(f"expected a target, found a {_literal_kind(place)}", place.line)
            self.gone |= {self.key(place.text)} if place.kind == "name" else set()
            name = f"{move.text.upper()} in line {node.line}" + (", end" if k else "")
            self.later(self.move, place, name, node.line, further)
        self.read_items(node)

    def read_spline(self, node: Node) -> None:
        """SPLINE WITH $TOOL = value, ... moves ENDSPLINE"""
        before = list[Use]()
        self.later(lambda: before.append(self.now))
        self.later(lambda: self.enter(self.with_settings(node.items[1])))
        self.read_items(node)
        self.later(lambda: self.enter(before.pop()))

    def with_settings(self, further: Node) -> Use:
        """Return the tool and the base in force where a move sets its own: WITH $TOOL = value, $BASE = value."""
        use = self.now
        for to, value in (item.items for item in further.items if item and item.kind == "setting"):
            if to.text.upper() in ("$TOOL", "$BASE"):
                use = self.with_frame(use, to.text.upper(), value)
        return use

    def move(self, value: Node, name: str, line: int, further: Node) -> None:
        """Take where a move leads."""
        use = self.with_settings(further)
        self.go_to(self.place(value), value, value.text if value.kind == "name" else name, line, use)

    def is_literal(self, value: Node) -> bool:
        """Whether a value is an aggregate."""
        return value.kind == "list"

    def target(self, name: str, value: Node) -> Target | Left:
        """The target that an aggregate in a move states."""
        return krl_target(name, _literal_kind(value), value)

    def composed(self, value: Node, depth: int) -> Place | None:
        """What `:` makes of a target and of frames that are known."""
        if value.kind != "operation" or set(value.text.split()) != {":"}:
            return None
        points = [k for k, item in enumerate(value.items) if self.is_point(item)]
        if points != [0] and points != [len(value.items) - 1]:
            return None
        origin = self.place(value.items[points[0]], depth)
        others = [self.frame_of(item) for k, item in enumerate(value.items) if k != points[0]]
        if origin is None or (points != [0] and any(other is None for other in others)):
            return None
        for frame_before in reversed(others) if points != [0] else ():
            origin = origin.moved(frame_before, NOWHERE)
        for frame_after in others if points == [0] else ():
            origin = origin.moved(NOWHERE, frame_after)
        return origin

    def is_point(self, value: Node) -> bool:
        """Whether a value is a target, and not a frame."""
        if value.kind == "list":
            return {"S", "T"} <= {item.text for item in value.items}
        return self.scope.type_of(self.key(value.text)) in ("POS", "E3POS", "E6POS")

    def frame_of(self, value: Node) -> np.ndarray | None:
        """Where a frame is that stands there, is given to a name to which no move goes, or is made of such by `:`."""
        if value.kind == "operation" and set(value.text.split()) == {":"}:
            frames = [part for part in map(self.frame_of, value.items) if part is not None]
            return np.linalg.multi_dot(frames) if len(frames) == len(value.items) else None
        is_target = value.kind == "name" and self.key(value.text) in self.gone
        value_of = None if is_target else self.scope.value(self.key(value.text)) if value.kind == "name" else value
        return None if value_of is None else frame(value_of)

    def shared(self, name: str) -> bool:
        """Whether a name is one that all files see though the data list is not one of which they see all."""
        return not self.public and self.scope.owner(name) == SHARED

    def point(self, name: str, kind: str, value: Node, declared: Declaration | None = None) -> None:
        """Take a target, or why it is left alone."""
        if value.kind in FOLLOWED and self.place(value) is not None:
            return
        use = self.of_move_data("F" + self.key(name)[1:]) if self.key(name).startswith("X") else None
        bare = Left(name, value.line, "no move", "is a FRAME to which no move of this file goes")
        unused = bare if kind == "FRAME" else None
        self.take(krl_target(name, kind, value), taught=use, unless_used=unused, declared=declared)

    def of_move_data(self, name: str) -> Use | None:
        """Tool and base of an FDAT; None where no file has it."""
        data = self.scope.value(name)
        if data is None or data.kind != "list":
            return None
        given = {item.text: item.items[0] for item in data.items}
        if "IPO_FRAME" in given and given["IPO_FRAME"].text.upper() == "#TCP":
            return Use(STANDING)
        tool, base = (
            given[name].text if name in given and given[name].kind == "number" else None
            for name in ("TOOL_NO", "BASE_NO")
        )
        return Use(tool, base)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield tools and bases by their numbers, and what $TOOL and $BASE are given."""
        for name, stated in self.stated.items():
            yield "tool" if name.startswith("$TOOL") else "frame", self.scope.label(name), stated
        for name in self.declared.values:
            if name.startswith(TABLES) and name.endswith("]"):
                value = self.scope.value(name)
                matrix = None if value is None else frame(value)
                yield "tool" if name.startswith("TOOL") else "frame", self.scope.label(krl_number(name)), matrix


def _parameters(routine: Node) -> list[str]:
    """The names of a routine's parameters."""
    lists = (item for item in routine.items if item and item.kind == "parameters")
    return [parameter.items[0].text.upper() for each in lists for parameter in each.items if parameter]


def _declared(routine: Node) -> Iterator[str]:
    """The names that a routine declares for itself."""
    for statement in (item.items[0] for item in routine.items if item and item.kind == "statement"):
        if statement.kind == "declaration":
            yield from (root(item.items[0].text).upper() for item in statement.items if item.kind == "variable")


def _in_force(call: Node) -> bool:
    """Whether a call is BAS(#TOOL, 1) or BAS(#BASE, 1)."""
    basic = call.text.upper() == "BAS" and len(call.items) == 2 and call.items[1].kind == "number"
    return basic and call.items[0].text.upper() in ("#TOOL", "#BASE")


def _literal_kind(value: Node) -> str:
    """The type of an aggregate in a move."""
    return value.text or ("E6AXIS" if any(item.text in JOINTS for item in value.items) else "E6POS")
