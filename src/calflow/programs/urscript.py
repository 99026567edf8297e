"""URScript: programs of Universal Robots, read after the script manual's grammar of statements and expressions."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from calflow.deployment.conventions import NOWHERE, Turn, pose_matrix
from calflow.programs.scanner import Expressions, Node, Reader, Token, refusal, scan
from calflow.programs.statements import Compound, Statements, Use
from calflow.programs.target import Left, Number, Program, Reason, Target

SUFFIXES = (".script", ".urscript", ".ur")
TOKENS = re.compile(
    r"""(?P<blank>[ \t\f\0\x1a]+|\\\r?\n|\xef\xbb\xbf)|(?P<comment>\#[^\r\n]*)|(?P<newline>\r\n|\r|\n|;)"""
    r"""|(?P<string>"[^"\r\n]*"|'[^'\r\n]*')|(?P<number>0[xX][0-9A-Fa-f]+(?![\w.])|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))"""
    r"""|(?P<name>[A-Za-z_\x80-\xff][A-Za-z0-9_\x80-\xff]*)|(?P<symbol>==|!=|<=|>=|\+=|-=|\*=|/=|[-+*/%=<>:,.$()\[\]{}])""",
    re.VERBOSE,
)
MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2}  # how many targets each has
PLACES = ("q", "pose", "pose_via", "pose_to")  # names by which a move's target may be given
DEFINITIONS = ("def", "sec", "thread")
MANUAL_MOVES = ("servoj", "servoc", "speedj", "speedl", "servoi")
BASE = "base"


def is_urscript(text: str) -> bool:
    """Return whether a text begins as a script does: with a definition, or a call of a move or of a setting."""
    blank = r"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*)*"
    first = r"(?:(?:def|sec|thread)\s+\w+\s*\(|(?:global\s+|local\s+)?\w+\s*=(?!=)|(?:move[jlpc]|set_\w+)\s*\()"
    return re.match(blank + first, text) is not None


def read_urscript(source: bytes) -> Program:
    """Read a script.

    Raises:
        InputError: it is not URScript as this reads it, with the line.
    """
    reader = Reader(_joined(scan(source.decode("latin-1"), TOKENS)))
    script = _Script(reader, _Values(reader))
    script.read()
    return script.whole(source)


def _joined(tokens: list[Token]) -> list[Token]:
    """Leave out the ends of lines within brackets."""
    depth, kept = 0, []
    for token in tokens:
        if token.kind == "symbol" and token.text in "([{":
            depth += 1
        elif token.kind == "symbol" and token.text in ")]}":
            depth -= 1
        if token.kind != "newline" or depth <= 0:
            kept.append(token)
    return kept


class _Values(Expressions):
    """URScript's expressions, with lists `[...]` and poses `p[...]`."""

    binary = frozenset({"+", "-", "*", "/", "%", "==", "!=", "<", ">", "<=", ">=", "and", "or", "xor", "is", "in"})
    unary = frozenset({"+", "-", "not", "run"})

    def value(self) -> Node:
        token = self.reader.next
        if (
            token.kind == "name"
            and token.text == "p"
            and self.reader.after.text == "["
            and self.reader.after.start == token.end
        ):
            self.reader.take()
            listed = self.listed("[", "]", "pose")
            return self.followed(replace(listed, start=token.start))
        if token.text == "[" and token.kind == "symbol":
            return self.followed(self.listed("[", "]"))
        if token.kind == "name":
            self.reader.take()
            return self.followed(Node("name", token.text, token.start, token.end, token.line))
        if token.text == "(" and token.kind == "symbol":
            return self.followed(super().value())
        return super().value()

    def followed(self, value: Node) -> Node:
        """What follows a value: a call, an index, a component."""
        while self.reader.next.kind == "symbol":
            if self.reader.next.text == "(" and value.kind == "name":
                items = self.arguments()
                value = Node("call", value.text, value.start, self.reader.last.end, value.line, items)
            elif self.reader.next.text == "[":
                index = self.listed("[", "]")
                value = Node("computed", value.text, value.start, index.end, value.line, (value, *index.items))
            elif self.reader.accept("."):
                name = self.reader.kind("name", "the name of a component")
                value = Node("name", f"{value.text}.{name.text}", value.start, name.end, value.line, (value,))
            else:
                break
        return value

    def argument(self) -> Node:
        """An expression, or name=c"""
        if self.reader.next.kind != "name" or self.reader.after.text != "=":
            return self.expression()
        name = self.reader.take()
        self.reader.take()
        value = self.expression()
        return Node("keyword", name.text, name.start, value.end, name.line, (value,))


@dataclass
class _Script(Statements):
    """What is gathered on the way through a script."""

    stated: list[tuple[str, Node]] = field(default_factory=list)
    computed: set[str] = field(default_factory=set)
    nears: dict[str, tuple[float, ...]] = field(default_factory=dict)
    tools: dict[str, np.ndarray] = field(default_factory=dict)
    defined: set[str] = field(default_factory=set)
    pending: list[Left] = field(default_factory=list)
    now: Use = field(default_factory=lambda: Use(frame=BASE))

    maker = "urscript"
    compounds = {
        **dict.fromkeys(DEFINITIONS, Compound("name arguments :", "end")),
        **dict.fromkeys(("while", "for"), Compound("value :", "end")),
        "if": Compound("value :", "end", {"elif": "value :", "else": ":"}),
    }

    @staticmethod
    def key(name: str) -> str:
        """Return a name as it is."""
        return name

    def read(self) -> None:
        """Statements to the end of the file."""
        self.reader.blank()
        while self.reader.next.kind != "end":
            if self.reader.word in self.closing:
                raise refusal(f"unexpected {self.reader.next}: no block is open here", self.reader.next)
            self.statement()

    def statement(self) -> None:
        """A line, or a block of lines."""
        word = self.reader.word
        if word in DEFINITIONS:
            before = self.now
            self.defined.add(self.reader.after.text)
            self.compound(word)
            self.now = before
        elif word in self.compounds:
            self.compound(word)
        elif self.reader.accept("$"):  # a label of the program's tree: $ 3 "Waypoint_1" "breakAfter"
            self.reader.kind("number", "the number of a label")
            while self.reader.next.kind == "string":
                self.reader.take()
        elif word in ("return", "run", "join", "kill", "break", "continue", "pass", "halt", "import"):
            self.reader.take()
            if self.reader.next.kind not in ("newline", "end"):
                self.value()
        else:
            if word in ("global", "local"):
                self.reader.take()
            self.assignment_or_call()
        self.reader.end_of_line()

    def value(self) -> None:
        """An expression, and what the calls in it say."""
        self.called(self.values.expression())

    def assignment_or_call(self) -> None:
        """name = value, name[0] = value, or a call."""
        to = self.values.expression()
        if sign := self.reader.accept("=", "+=", "-=", "*=", "/="):
            if to.kind not in ("name", "computed"):
                raise refusal(f"expected a name before '{sign.text}'", sign)
            value = self.values.expression()
            self.called(value)
            self.given(to, value, sign.text)
        elif to.kind == "call" or (to.kind == "name" and "." in to.text):
            self.called(to)
        elif to.kind == "name" and to.text in ("sync", "enter_critical", "exit_critical", "stopj", "textmsg"):
            pass
        else:
            raise refusal(f"expected a call or an assignment, found {self.reader.next}", self.reader.next)

    def given(self, to: Node, value: Node, sign: str) -> None:
        """Take what is given to a name."""
        if to.kind == "name" and sign == "=":
            if value.kind in ("pose", "list"):
                self.stated.append((to.text, value))
                near = _joints(value)
                if near:
                    self.nears[to.text] = near
            else:
                self.computed.add(to.text)
        elif to.text or to.items:
            name = to.text or to.items[0].text
            self.left.append(
                Left(
                    name,
                    to.line,
                    "changed on the way",
                    "has a part of it changed on the way: what that makes of it is not known",
                )
            )

    def called(self, value: Node) -> None:
        """Take what the calls in an expression say: where moves go, and with which tool."""
        for node in value.walk():
            if node.kind != "call":
                continue
            if node.text in MOVES:
                self.move(node)
            elif node.text == "set_tcp" and node.items:
                self.set_tool(node.items[0])
            elif node.text in self.defined:
                inside = [one for one in node.walk() if one.kind == "pose" and _numbers(one, "pose")]
                self.left += [
                    Left(
                        f"pose in line {one.line}",
                        one.line,
                        "computed",
                        f"is given to {node.text}(): where it leads is not known",
                    )
                    for one in inside
                ]
            elif node.text in MANUAL_MOVES:
                self.left.append(
                    Left(
                        f"{node.text}() in line {node.line}",
                        node.line,
                        "computed",
                        "is no move to a place that stands in the program",
                    )
                )

    def set_tool(self, value: Node) -> None:
        """set_tcp(p[...])"""
        if value.kind == "name":
            stated = [given for name, given in self.stated if name == value.text]
            value = stated[0] if len(stated) == 1 and value.text not in self.computed else value
        numbers = _numbers(value, "pose")
        self.now = Use(None, BASE)
        if numbers:
            self.now = Use(tool := f"set_tcp of line {value.line}", BASE)
            self.tools[tool] = pose_matrix([number.value for number in numbers], "vector")

    def move(self, call: Node) -> None:
        """movej(target, a=1, v=1), movec(via, target), with get_inverse_kin(target, qnear) as a target too."""
        by_name = [one.items[0] for one in call.items if one.kind == "keyword" and one.text in PLACES]
        places = [*call.arguments[: MOVES[call.text]], *by_name][: MOVES[call.text]]
        if len(places) < MOVES[call.text]:
            raise refusal(f"{call.text}: expected {MOVES[call.text]} target{'s' * (MOVES[call.text] > 1)}", call.token)
        for k, place in enumerate(places):
            own = f"{call.text} in line {call.line}" + (", via" if k == 0 and len(places) > 1 else "")
            near = None
            if place.kind == "call" and place.text == "get_inverse_kin" and place.items:
                hint = place.keyword("qnear") or (place.arguments[1] if len(place.arguments) > 1 else None)
                near = self.near(hint)
                place = place.items[0]
            if place.kind in ("pose", "list"):
                self.point(own, place)
                self.uses.setdefault(own, []).append(replace(self.now, near=near))
            elif place.kind == "name" and "." not in place.text:
                self.uses.setdefault(place.text, []).append(replace(self.now, near=near))
                self.pending.append(Left(own, call.line, "elsewhere", place.text))
            else:
                self.left.append(Left(own, call.line, "computed", "goes to a place that is computed"))

    def near(self, hint: Node | None) -> tuple[float, ...] | None:
        """The readings that a hint states."""
        if hint is None:
            return None
        return self.nears.get(hint.text) if hint.kind == "name" else _joints(hint)

    def point(self, name: str, value: Node) -> None:
        """Take a target, or say why it is left alone."""
        if len(value.items) != 6:
            raise refusal(f"{name}: expected 6 values, found {len(value.items)}", value.token)
        numbers = _numbers(value, value.kind)
        turn: Turn | None = None if value.kind == "list" else "vector"
        self.take(
            Target(name, value.line, numbers, turn) if numbers else Left(name, value.line, "computed", "is computed")
        )

    def whole(self, source: bytes) -> Program:
        """Return the program; of the names, those to which a move goes are targets."""
        for name, value in self.stated:
            if self.uses.get(name):
                self.point(name, value)
            elif _numbers(value, "pose"):
                self.left.append(
                    Left(name, value.line, "no move", "is a pose to which no move of this file goes by its name")
                )
        known = {name for name, _ in self.stated}
        for move in self.pending:
            if move.note in self.computed or move.note not in known:
                reason: Reason = "computed" if move.note in self.computed else "elsewhere"
                self.left.append(
                    Left(move.name, move.line, reason, f"goes to {move.note}, which is computed or stated elsewhere")
                )
        return self.program(source, self.tools, {BASE: NOWHERE})


def _numbers(value: Node, kind: str) -> tuple[Number, ...] | None:
    """The six numbers of a pose [m and rad] or of joint readings [rad]; None where one is computed. d2r(90) counts as one."""
    if value.kind != kind or len(value.items) != 6:
        return None
    found = []
    for item in value.items:
        scale = 1.0
        if item.kind == "call" and item.text == "d2r" and len(item.items) == 1:
            item, scale = item.items[0], np.pi / 180
        if item.kind != "number" or "x" in item.text.lower():
            return None
        found.append(Number(item.start, item.end, item.text, scale))
    return tuple(found)


def _joints(value: Node) -> tuple[float, ...] | None:
    numbers = _numbers(value, "list")
    return tuple(number.value for number in numbers) if numbers else None
