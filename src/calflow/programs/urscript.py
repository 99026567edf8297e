"""URScript: programs of Universal Robots, by the script manual's grammar of statements and expressions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOTATIONS, NOWHERE
from calflow.files.problems import refuse
from calflow.programs.names import Call
from calflow.programs.statements import Destination, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaf
from calflow.programs.target import Number, Skipped, Target, Use

SUFFIXES = (".script", ".urscript", ".ur")
MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2}  # number of targets of each
KEYWORDS = ("q", "pose", "pose_via", "pose_to")  # keywords of a move's targets
BARE = ("sync", "enter_critical", "exit_critical", "stopj", "textmsg")  # statements that may lack brackets
MANUAL_MOVES = ("servoj", "servoc", "speedj", "speedl", "servoi")
COMPOSED = ("pose_trans", "pose_add")
BASE = "base"
NOTATION = NOTATIONS["urscript"]
# A script begins with a definition, or a call of a move or of a setting.
BEGINS = re.compile(
    r"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*)*"
    r"(?:(?:def|sec|thread)\s+\w+\s*\(|(?:global\s+|local\s+)?\w+\s*=(?!=)|(?:move[jlpc]|set_\w+)\s*\()"
)


class _Joined:
    """The filter of tokens that drops line ends within brackets."""

    always_accept = ("_NL",)

    def process(self, tokens: Iterator[Any]) -> Iterator[Any]:
        """Yield the tokens kept."""
        depth = 0
        for token in tokens:
            depth += (token in ("(", "[")) - (token in (")", "]"))
            if token.type != "_NL" or depth <= 0:
                yield token


class _Builder(TreeBuilder):
    """URScript's poses `p[...]`; elements of lists count as computed."""

    def pose(self, children: Sequence[Any]) -> Node:
        """p[x, y, z, rx, ry, rz]"""
        sign, values = children
        return values._replace(kind="pose", start=sign.start_pos)

    def name(self, children: Sequence[Any]) -> Node:
        """A name with components and indices."""
        token, *parts = children
        text = ".".join([token, *(part.items[0].text for part in parts if part.kind == "component")])
        return self.part(text, leaf(token, "name"), parts) if parts else leaf(token, "name")

    def followed(self, children: Sequence[Any]) -> Node:
        """A component or element of any other value."""
        value, part = children
        return self.part(value.text + (f".{part.items[0].text}" if part.kind == "component" else ""), value, [part])

    def part(self, text: str, value: Node, parts: Sequence[Node]) -> Node:
        """A component or element of a value."""
        kind = "computed" if parts[-1].kind == "index" else "name"
        indices = [item for part in parts if part.kind == "index" for item in part.items]
        return branch(kind, text, value, parts[-1], [value, *indices])


@dataclass
class UrScript(Statements):
    """A script."""

    stated: dict[str, np.ndarray] = field(default_factory=dict)  # tools by label
    poses: dict[int, np.ndarray | None] = field(default_factory=dict)  # evaluated, by byte position
    tools: list[Node] = field(default_factory=list)  # arguments of set_tcp
    defined: set[str] = field(default_factory=set)  # functions
    routine: str = ""  # the function being read
    routes: list[Node] = field(default_factory=list)  # destinations of moves
    move_targets: set[str] = field(default_factory=set)  # names of targets of moves, also if computed from
    active: Use = field(default_factory=lambda: Use(frame=BASE))

    maker, flange, base, sign, remark = "urscript", "", BASE, " = ", "#"
    grammar = Grammar("expressions", "urscript", builder=_Builder(), postlex=_Joined())

    def __post_init__(self) -> None:
        super().__post_init__()
        self.defer(self.find_targets)

    def read_definition(self, node: Node) -> None:
        """def name(parameter): ... end; it does not affect the active tool."""
        names = [item.text for item in node.items[0].items]
        head, block = (self.with_local_names(node.items[0].text, names, item) for item in node.items)
        self.defined.add(head.text)
        self.symbols.parameters[head.text] = [item.text for item in head.items]
        self.symbols.private |= {item.text for item in head.items}
        before, outside, self.routine = list[Use](), self.routine, head.text
        self.defer(lambda: before.append(self.active))
        self.defer(self.enter_function)
        self.read_items(block)
        self.routine = outside
        self.defer(lambda: self.activate(before.pop()))

    def enter_function(self) -> None:
        """Make the active tool unknown unless the script sets only one."""
        if not all(tool.same(self.tools[0]) for tool in self.tools):
            self.active = Use(None, BASE)

    def read_simple(self, node: Node) -> None:
        """name = value or name[0] = value, global or local; or a call."""
        scope, to, sign, value = node.items
        if sign:
            if to.kind not in ("name", "computed"):
                raise refuse(f"expected a name before '{sign.text}'", line=sign.line)
            self.read(value)
            self.assign_value(scope, to, value, sign.text)
        elif to.kind == "call" or (to.kind == "name" and ("." in to.text or to.text in BARE)):
            self.read(to)
        else:
            raise refuse("expected a call or an assignment", line=to.line)

    def assign_value(self, scope: Node | None, to: Node, value: Node, sign: str) -> None:
        """Record an assignment."""
        name = to.text or next((item.text for item in to.items), "")
        whole = to.kind == "name" and sign == "="
        self.symbols.private.add(name)
        self.symbols.values[name].append(value if whole else value._replace(kind="computed"))
        if not whole:
            self.skip(name, to.line, "changed on the way", "is changed in part on the way: the result is unknown")
        elif value.kind in ("pose", "list"):
            self.defer(self.add_point, scope, to, value)

    def read_call(self, node: Node) -> None:
        """A call: of a move, a setting of the tool, or a function of the script."""
        if node.text in MOVES:
            places = self.places(node)
            self.routes += map(_posed, places)
            self.defer(self.move, node, places)
        elif node.text == "set_tcp" and node.items:
            self.symbols.frame_setters.add(self.routine)
            self.tools.append(node.items[0])
            self.symbols.private.add(_tool(node.items[0]))
            self.defer(self.set_tool, node.items[0])
        elif node.text in self.defined:
            self.symbols.calls.append(Call(self.routine, node.text, node.items))
            self.defer(self.leave_function, node.text)
            why = f"is passed to {node.text}(): its use is unknown"
            for pose in (pose for pose in node.walk() if pose.kind == "pose" and _numbers(pose, "pose")):
                self.skip(f"pose in line {pose.line}", pose.line, "computed", why)
        elif node.text in MANUAL_MOVES:
            why = "is no move to a target of the program"
            self.skip(f"{node.text}() in line {node.line}", node.line, "computed", why)
        self.read_items(node)

    def leave_function(self, function: str) -> None:
        """Make the active tool unknown after a function that sets it."""
        if function in self.scope.project.frame_setters:
            self.active = Use(None, BASE)

    def find_targets(self) -> None:
        """Find the names of targets of moves, through assignments and calls, until none is new."""
        names = {route.text for route in self.routes if route.kind == "name"}
        while True:
            self.move_targets |= names
            places = [self.destination(route) for route in self.routes]
            places += [other for place in places if place for other in self.alternatives(place)[0]]
            names = {place.origin.text for place in places if place is not None and place.origin.kind == "name"}
            if names <= self.move_targets:
                return

    def set_tool(self, value: Node) -> None:
        """set_tcp(p[...])"""
        matrix = self.matrix(value)
        self.active = Use(None, BASE)
        if matrix is not None:
            self.active = Use(_tool(value), BASE)
            self.stated[_tool(value)] = matrix

    @staticmethod
    def places(call: Node) -> list[Node]:
        """Return the targets of a move: movej(target, a=1, v=1), movec(via, target).

        Raises:
            InputError: it lacks one.
        """
        wanted = MOVES[call.text]
        by_name = [item.items[0] for item in call.items if item.kind == "keyword" and item.text in KEYWORDS]
        arguments = [*call.arguments[:wanted], *by_name][:wanted]
        if len(arguments) < wanted:
            raise refuse(f"{call.text}: expected {wanted} target{'s' * (wanted > 1)}", line=call.line)
        return arguments

    def move(self, call: Node, places: Sequence[Node]) -> None:
        """Record a move; get_inverse_kin(target, qnear) is a target, too."""
        for k, value in enumerate(places):
            name = f"{call.text} in line {call.line}" + (", via" if k == 0 and len(places) > 1 else "")
            use = self.active
            if value.kind == "call" and value.text == "get_inverse_kin" and value.items:
                hint = value.keyword("qnear") or (value.arguments[1] if len(value.arguments) > 1 else None)
                use = replace(use, near=self.near(hint))
            goal = self.destination(_posed(value))
            origin = goal.origin if goal else value
            if goal and not use.near and origin.text.endswith("_p"):  # PolyScope states its readings as Waypoint_1_q
                use = replace(use, near=self.near(origin._replace(text=f"{origin.text[:-2]}_q")))
            self.add_move(goal, value, name, call.line, use)
            if origin.text in self.undeclared:
                why = f"goes to {origin.text}, which is computed or defined elsewhere"
                self.undeclared[origin.text] = Skipped(name, call.line, "elsewhere", why)

    def destination(self, value: Node, depth: int = 0) -> Destination | None:
        """The destination of an expression; unknown for components."""
        return None if value.kind == "name" and "." in value.text else super().destination(value, depth)

    def is_literal(self, value: Node) -> bool:
        """Whether a value in a move is a literal target."""
        return value.kind in ("pose", "list")

    def composed(self, value: Node, depth: int) -> Destination | None:
        """The destination that pose_trans or pose_add computes from a target and known poses."""
        if value.kind != "call" or value.text not in COMPOSED or len(value.items) != 2:
            return None
        first = self.is_first(value)
        origin, matrix = self.destination(value.items[not first], depth), self.matrix(value.items[first])
        if origin is None or origin.origin.kind == "list" or (matrix is None and not first):
            return None
        if value.text == "pose_trans" or matrix is None:
            return origin.transformed(NOWHERE, matrix) if first else origin.transformed(matrix, NOWHERE)
        shift, turn = matrix.copy(), matrix.copy()
        shift[:3, :3], turn[:3, 3] = np.eye(3), 0.0
        return origin.transformed(shift, turn) if first else None  # pose_add adds positions and multiplies rotations

    def is_first(self, call: Node) -> bool:
        """Whether the first of two composed poses is the target: the one that moves use, else the one not inverted."""
        used = [
            any(part.kind == "name" and part.text in self.move_targets for part in item.walk()) for item in call.items
        ]
        inverted = call.items[1].kind == "call" and self.matrix(call.items[1]) is not None
        return used[0] if used[0] != used[1] else call.text == "pose_add" or inverted

    def matrix(self, value: Node) -> np.ndarray | None:
        """The transform (4, 4) of a known pose other than a target; None if unknown."""
        if value.kind == "name":
            resolved = None if value.text in self.move_targets else self.scope.value(value.text)
            return None if resolved is None else self.matrix(resolved)
        if value.kind == "call" and value.text == "pose_inv" and len(value.items) == 1:
            inner = self.matrix(value.items[0])
            return None if inner is None else np.linalg.inv(inner)
        if value.kind == "call" and value.text == "pose_trans" and len(value.items) == 2:
            before, after = (self.matrix(item) for item in value.items)
            return None if before is None or after is None else before @ after
        if value.kind != "pose" or len(value.items) != 6:
            return None
        if value.start not in self.poses:
            numbers = [self.number(item) for item in value.items]
            pose = None if None in numbers else NOTATION.pose(np.array(numbers, dtype=float))
            self.poses[value.start] = pose
        return self.poses[value.start]

    def number(self, value: Node, depth: int = 0) -> float | None:
        """The value of an expression, with d2r(90)."""
        if value.kind == "call" and value.text == "d2r" and len(value.items) == 1:
            inner = self.number(value.items[0], depth + 1)
            return None if inner is None else float(np.deg2rad(inner))
        return super().number(value, depth)

    def near(self, hint: Node | None) -> tuple[float, ...] | None:
        """The readings that qnear states."""
        given = self.symbols.values.get(hint.text, []) if hint is not None and hint.kind == "name" else [hint]
        joints = [_numbers(argument, "list") for argument in given if argument is not None]
        return next((tuple(number.value for number in numbers) for numbers in reversed(joints) if numbers), None)

    def target(self, name: str, value: Node) -> Target | Skipped:
        """Return the target of a pose or list, or why it is skipped."""
        if len(value.items) != 6:
            raise refuse(f"{name}: expected 6 values, found {len(value.items)}", line=value.line)
        numbers = _numbers(value, value.kind)
        turn = None if value.kind == "list" else NOTATION.turn
        return (
            Target(name, value.line, numbers, turn) if numbers else Skipped(name, value.line, "computed", "is computed")
        )

    def add_point(self, scope: Node | None, to: Node, value: Node) -> None:
        """Record the value of a name as a target if a move uses it."""
        name, start = to.text, scope.start if scope else to.start
        unused = Skipped(name, value.line, "no move", "is a pose that no move of this file uses by name")
        if name in self.move_targets or _numbers(value, "pose"):
            declared = self.declaration(start, f"{scope.text} " if scope else "", name, value, value.end)
            self.add_target(self.target(name, value), if_unused=unused, declared=declared)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield the tools that the script sets."""
        for name, matrix in self.stated.items():
            yield "tool", self.scope.label(name), matrix


def _posed(value: Node) -> Node:
    """The pose in get_inverse_kin(pose, qnear); other values unchanged."""
    return value.items[0] if value.kind == "call" and value.text == "get_inverse_kin" and value.items else value


def _tool(value: Node) -> str:
    return f"set_tcp of line {value.line}"


def _numbers(value: Node, kind: str) -> tuple[Number, ...] | None:
    """The six numbers of a pose [m and rad] or of joint readings [rad], d2r(90) among them; None if one is computed."""
    if value.kind != kind or len(value.items) != 6:
        return None
    parts = []
    for item in value.items:
        scale = 1.0
        if item.kind == "call" and item.text == "d2r" and len(item.items) == 1:
            item, scale = item.items[0], np.pi / 180
        if item.kind != "number" or "x" in item.text.lower():
            return None
        parts.append(item.number(scale))
    return tuple(parts)
