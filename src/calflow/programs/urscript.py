"""URScript: programs of Universal Robots, read after the script manual's grammar of statements and expressions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOWHERE, Turn, inverse, pose_matrix
from calflow.programs.names import Call
from calflow.programs.statements import Place, Statements
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaf, refusal
from calflow.programs.target import Left, Number, Target, Use

SUFFIXES = (".script", ".urscript", ".ur")
MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2}  # how many targets each has
PLACES = ("q", "pose", "pose_via", "pose_to")  # names by which a move's target may be given
BARE = ("sync", "enter_critical", "exit_critical", "stopj", "textmsg")  # what stands alone without a call
MANUAL_MOVES = ("servoj", "servoc", "speedj", "speedl", "servoi")
COMPOSED = ("pose_trans", "pose_add")
BASE = "base"


# A script begins with a definition, or a call of a move or of a setting.
BEGINS = re.compile(
    r"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*)*"
    r"(?:(?:def|sec|thread)\s+\w+\s*\(|(?:global\s+|local\s+)?\w+\s*=(?!=)|(?:move[jlpc]|set_\w+)\s*\()"
)


class _Joined:
    """Leaves out the ends of lines within brackets."""

    always_accept = ("_NL",)

    def process(self, tokens: Iterator[Any]) -> Iterator[Any]:
        """Return the tokens without these."""
        depth = 0
        for token in tokens:
            depth += (token in ("(", "[")) - (token in (")", "]"))
            if token.type != "_NL" or depth <= 0:
                yield token


class _Builder(TreeBuilder):
    """URScript's poses `p[...]`, and what has an index, which is not looked into."""

    def pose(self, children: Sequence[Any]) -> Node:
        """p[x, y, z, rx, ry, rz]"""
        sign, values = children
        return values._replace(kind="pose", start=sign.start_pos)

    def name(self, children: Sequence[Any]) -> Node:
        """A name with its components, or something in what it names."""
        token, *parts = children
        text = ".".join([token, *(part.items[0].text for part in parts if part.kind == "component")])
        return self.part(text, leaf(token, "name"), parts) if parts else leaf(token, "name")

    def followed(self, children: Sequence[Any]) -> Node:
        """A component or an index of any other value."""
        value, part = children
        return self.part(value.text + (f".{part.items[0].text}" if part.kind == "component" else ""), value, [part])

    def part(self, text: str, value: Node, parts: Sequence[Node]) -> Node:
        """Something in a value."""
        kind = "computed" if parts[-1].kind == "index" else "name"
        indices = [item for part in parts if part.kind == "index" for item in part.items]
        return branch(kind, text, value, parts[-1], [value, *indices])


@dataclass
class UrScript(Statements):
    """What is gathered on the way through a script."""

    stated: dict[str, np.ndarray] = field(default_factory=dict)  # tools by what they are called
    poses: dict[int, np.ndarray | None] = field(default_factory=dict)  # of numbers, by where they stand
    tools: list[Node] = field(default_factory=list)  # that the script sets
    defined: set[str] = field(default_factory=set)
    routine: str = ""  # the function that is read
    routes: list[Node] = field(default_factory=list)  # where moves go
    gone: set[str] = field(default_factory=set)  # names of targets: moves go to them, or to what is computed from them
    now: Use = field(default_factory=lambda: Use(frame=BASE))

    maker, flange, base, sign, remark = "urscript", "", BASE, " = ", "#"
    grammar = Grammar("expressions", "urscript", builder=_Builder(), postlex=_Joined())

    def __post_init__(self) -> None:
        super().__post_init__()
        self.later(self.settle)

    def read_definition(self, node: Node) -> None:
        """def name(parameter): ... end, after which the tool is the one before it."""
        names = [item.text for item in node.items[0].items]
        head, block = (self.with_names_of(node.items[0].text, names, item) for item in node.items)
        self.defined.add(head.text)
        self.declared.parameters[head.text] = [item.text for item in head.items]
        self.declared.private |= {item.text for item in head.items}
        before, outside, self.routine = list[Use](), self.routine, head.text
        self.later(lambda: before.append(self.now))
        self.later(self.begin)
        self.read_items(block)
        self.routine = outside
        self.later(lambda: self.enter(before.pop()))

    def begin(self) -> None:
        """A function is called with a tool that is known where the script sets one alone."""
        if not all(tool.same(self.tools[0]) for tool in self.tools):
            self.now = Use(None, BASE)

    def read_simple(self, node: Node) -> None:
        """name = value, name[0] = value, after the word of a scope, or a call."""
        scope, to, sign, value = node.items
        if sign:
            if to.kind not in ("name", "computed"):
                raise refusal(f"expected a name before '{sign.text}'", sign.line)
            self.read(value)
            self.given(scope, to, value, sign.text)
        elif to.kind == "call" or (to.kind == "name" and ("." in to.text or to.text in BARE)):
            self.read(to)
        else:
            raise refusal("expected a call or an assignment", to.line)

    def given(self, scope: Node | None, to: Node, value: Node, sign: str) -> None:
        """Take what is given to a name."""
        name = to.text or next((item.text for item in to.items), "")
        whole = to.kind == "name" and sign == "="
        self.declared.private.add(name)
        self.declared.values[name].append(value if whole else value._replace(kind="computed"))
        if not whole:
            why = "has a part of it changed on the way: what that makes of it is not known"
            self.left.append(Left(name, to.line, "changed on the way", why))
        elif value.kind in ("pose", "list"):
            self.later(self.point, scope, to, value)

    def read_call(self, node: Node) -> None:
        """What a call says: where moves go, and with which tool."""
        if node.text in MOVES:
            places = self.places(node)
            self.routes += map(_posed, places)
            self.later(self.move, node, places)
        elif node.text == "set_tcp" and node.items:
            self.declared.setting.add(self.routine)
            self.tools.append(node.items[0])
            self.declared.private.add(_tool(node.items[0]))
            self.later(self.set_tool, node.items[0])
        elif node.text in self.defined:
            self.declared.calls.append(Call(self.routine, node.text, node.items))
            self.later(self.back_from, node.text)
            why = f"is given to {node.text}(): where it leads is not known"
            for pose in (pose for pose in node.walk() if pose.kind == "pose" and _numbers(pose, "pose")):
                self.leave(f"pose in line {pose.line}", pose.line, "computed", why)
        elif node.text in MANUAL_MOVES:
            why = "is no move to a place that stands in the program"
            self.leave(f"{node.text}() in line {node.line}", node.line, "computed", why)
        self.read_items(node)

    def back_from(self, function: str) -> None:
        """A function that sets a tool leaves it unknown."""
        if function in self.scope.project.setting:
            self.now = Use(None, BASE)

    def settle(self) -> None:
        """Find which names are targets, whose numbers no other target may be reckoned with."""
        names = {route.text for route in self.routes if route.kind == "name"}
        while True:
            self.gone |= names
            places = [self.place(route) for route in self.routes]
            places += [other for place in places if place for other in self.alternatives(place)[0]]
            names = {place.origin.text for place in places if place is not None and place.origin.kind == "name"}
            if names <= self.gone:
                return

    def set_tool(self, value: Node) -> None:
        """set_tcp(p[...])"""
        matrix = self.matrix(value)
        self.now = Use(None, BASE)
        if matrix is not None:
            self.now = Use(_tool(value), BASE)
            self.stated[_tool(value)] = matrix

    @staticmethod
    def places(call: Node) -> list[Node]:
        """Where a call of a move goes: movej(target, a=1, v=1), movec(via, target).

        Raises:
            InputError: it does not say so.
        """
        wanted = MOVES[call.text]
        by_name = [item.items[0] for item in call.items if item.kind == "keyword" and item.text in PLACES]
        arguments = [*call.arguments[:wanted], *by_name][:wanted]
        if len(arguments) < wanted:
            raise refusal(f"{call.text}: expected {wanted} target{'s' * (wanted > 1)}", call.line)
        return arguments

    def move(self, call: Node, places: Sequence[Node]) -> None:
        """Take where a move goes, with get_inverse_kin(target, qnear) as a target too."""
        for k, value in enumerate(places):
            name = f"{call.text} in line {call.line}" + (", via" if k == 0 and len(places) > 1 else "")
            use = self.now
            if value.kind == "call" and value.text == "get_inverse_kin" and value.items:
                hint = value.keyword("qnear") or (value.arguments[1] if len(value.arguments) > 1 else None)
                use = replace(use, near=self.near(hint))
            place = self.place(_posed(value))
            origin = place.origin if place else value
            if place and not use.near and origin.text.endswith("_p"):  # whose readings PolyScope states as Waypoint_1_q
                use = replace(use, near=self.near(origin._replace(text=f"{origin.text[:-2]}_q")))
            self.go_to(place, value, name, call.line, use)
            if origin.text in self.gone_to:
                why = f"goes to {origin.text}, which is computed or stated elsewhere"
                self.gone_to[origin.text] = Left(name, call.line, "elsewhere", why)

    def place(self, value: Node, depth: int = 0) -> Place | None:
        """The place that an expression means; that of a component is not known."""
        return None if value.kind == "name" and "." in value.text else super().place(value, depth)

    def is_literal(self, value: Node) -> bool:
        """Whether a value is a pose or a list."""
        return value.kind in ("pose", "list")

    def composed(self, value: Node, depth: int) -> Place | None:
        """What pose_trans or pose_add make of a target and of poses that are known."""
        if value.kind != "call" or value.text not in COMPOSED or len(value.items) != 2:
            return None
        first = self.is_first(value)
        origin, matrix = self.place(value.items[not first], depth), self.matrix(value.items[first])
        if origin is None or origin.origin.kind == "list" or (matrix is None and not first):
            return None
        if value.text == "pose_trans" or matrix is None:
            return origin.moved(NOWHERE, matrix) if first else origin.moved(matrix, NOWHERE)
        shift, turn = matrix.copy(), matrix.copy()
        shift[:3, :3], turn[:3, 3] = np.eye(3), 0.0
        return origin.moved(shift, turn) if first else None  # pose_add adds places, and multiplies orientations

    def is_first(self, call: Node) -> bool:
        """Whether of two poses that are composed the first is the target: the one to which moves go, else that in the other."""
        gone = [any(part.kind == "name" and part.text in self.gone for part in item.walk()) for item in call.items]
        inverted = call.items[1].kind == "call" and self.matrix(call.items[1]) is not None
        return gone[0] if gone[0] != gone[1] else call.text == "pose_add" or inverted

    def matrix(self, value: Node) -> np.ndarray | None:
        """The transform that a pose of numbers means, or what is made of such; None where it is not known."""
        if value.kind == "name":
            resolved = None if value.text in self.gone else self.scope.value(value.text)
            return None if resolved is None else self.matrix(resolved)
        if value.kind == "call" and value.text == "pose_inv" and len(value.items) == 1:
            inner = self.matrix(value.items[0])
            return None if inner is None else inverse(inner)
        if value.kind == "call" and value.text == "pose_trans" and len(value.items) == 2:
            before, after = (self.matrix(item) for item in value.items)
            return None if before is None or after is None else before @ after
        if value.kind != "pose" or len(value.items) != 6:
            return None
        if value.start not in self.poses:
            numbers = [self.number(item) for item in value.items]
            pose = None if None in numbers else pose_matrix(np.array(numbers, dtype=float), "vector")
            self.poses[value.start] = pose
        return self.poses[value.start]

    def number(self, value: Node, depth: int = 0) -> float | None:
        """The number that an expression is, d2r(90) among them."""
        if value.kind == "call" and value.text == "d2r" and len(value.items) == 1:
            inner = self.number(value.items[0], depth + 1)
            return None if inner is None else float(np.deg2rad(inner))
        return super().number(value, depth)

    def near(self, hint: Node | None) -> tuple[float, ...] | None:
        """The readings that a hint states."""
        given = self.declared.values.get(hint.text, []) if hint is not None and hint.kind == "name" else [hint]
        joints = [_numbers(argument, "list") for argument in given if argument is not None]
        return next((tuple(number.value for number in numbers) for numbers in reversed(joints) if numbers), None)

    def target(self, name: str, value: Node) -> Target | Left:
        """Return a target, or why it is left alone."""
        if len(value.items) != 6:
            raise refusal(f"{name}: expected 6 values, found {len(value.items)}", value.line)
        numbers = _numbers(value, value.kind)
        turn: Turn | None = None if value.kind == "list" else "vector"
        return Target(name, value.line, numbers, turn) if numbers else Left(name, value.line, "computed", "is computed")

    def point(self, scope: Node | None, to: Node, value: Node) -> None:
        """Take what is given to a name, which is a target where a move goes to it."""
        name, start = to.text, scope.start if scope else to.start
        unused = Left(name, value.line, "no move", "is a pose to which no move of this file goes by its name")
        if name in self.gone or _numbers(value, "pose"):
            declared = self.declared_as(start, f"{scope.text} " if scope else "", name, value, value.end)
            self.take(self.target(name, value), unless_used=unused, declared=declared)

    def frames(self) -> Iterator[tuple[str, str, np.ndarray | None]]:
        """Yield the tools that the script sets."""
        for name, matrix in self.stated.items():
            yield "tool", self.scope.label(name), matrix


def _posed(value: Node) -> Node:
    """The pose of get_inverse_kin(pose, qnear), or a value itself."""
    return value.items[0] if value.kind == "call" and value.text == "get_inverse_kin" and value.items else value


def _tool(value: Node) -> str:
    return f"set_tcp of line {value.line}"


def _numbers(value: Node, kind: str) -> tuple[Number, ...] | None:
    """The six numbers of a pose [m and rad] or of joint readings [rad]; None where one is computed. d2r(90) counts as one."""
    if value.kind != kind or len(value.items) != 6:
        return None
    parts = []
    for item in value.items:
        scale = 1.0
        if item.kind == "call" and item.text == "d2r" and len(item.items) == 1:
            item, scale = item.items[0], np.pi / 180
        if item.kind != "number" or "x" in item.text.lower():
            return None
        parts.append(Number(item.start, item.end, item.text, scale))
    return tuple(parts)
