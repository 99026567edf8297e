"""KRL: programs of KUKA robots, module (.src) and data list (.dat), read after the KRL reference guide, a statement a line.

KRL's values: its expressions with aggregates, and targets and frames as it writes them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from calflow.deployment.conventions import NOWHERE, pose_matrix
from calflow.programs.scanner import Expressions, Node, Reader, refusal, scan
from calflow.programs.target import External, Flag, KrlConfiguration, Left, Number, Program, Target

POSES, AXES = ("POS", "E3POS", "E6POS", "FRAME"), ("AXIS", "E3AXIS", "E6AXIS")
PLACE, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = tuple(f"E{k}" for k in range(1, 7))


class KrlValues(Expressions):
    """KRL's expressions, with aggregates `{TYPE: NAME value, ...}`; a component's text is its name, its item the value."""

    binary = frozenset(
        {"+", "-", "*", "/", "==", "<>", "<", ">", "<=", ">=", ":", "AND", "OR", "EXOR", "B_AND", "B_OR", "B_EXOR"}
    )
    unary = frozenset({"+", "-", "NOT", "B_NOT"})

    def __init__(self, reader: Reader) -> None:
        super().__init__(reader)
        self.literals: list[Node] = []  # all that have the components of a target, wherever they stand

    def value(self) -> Node:
        token = self.reader.next
        if token.text == "{":
            found = self.aggregate()
            if {item.text for item in found.items} >= {*PLACE, "S", "T"}:
                self.literals.append(found)
            return found
        if token.kind in ("enum", "bits"):
            self.reader.take()
            return Node("computed", token.text, token.start, token.end, token.line)
        if token.kind == "name":
            return self.reference()
        return super().value()

    def reference(self) -> Node:
        """A variable, with its indices and components, or a call."""
        first = self.reader.kind("name", "a name")
        text, inner = first.text, list[Node]()
        while True:
            if self.reader.accept("["):
                index = []
                while not self.reader.accept("]"):
                    index.append(Node("computed", "", 0, 0, 0) if self.reader.next.text == "," else self.expression())
                    if not self.reader.accept(",") and self.reader.next.text != "]":
                        self.reader.expect("]")
                text += "[" + ",".join(item.text for item in index) + "]"
                inner += index
            elif self.reader.next.text == "." and self.reader.accept("."):
                text += "." + self.reader.kind("name", "the name of a component").text
            elif self.reader.next.text == "(":
                items = self.arguments()
                return Node("call", text, first.start, self.reader.last.end, first.line, items)
            else:
                return Node("name", text, first.start, self.reader.last.end, first.line, tuple(inner))

    def arguments(self) -> tuple[Node, ...]:
        """Arguments in brackets; some may be left out between commas."""
        self.reader.expect("(")
        items = []
        while not self.reader.accept(")"):
            if self.reader.next.text not in (",", ")"):
                items.append(self.expression())
            if self.reader.next.text != ")":
                self.reader.expect(",", ")")
        return tuple(items)

    def aggregate(self) -> Node:
        """{TYPE: NAME value, NAME value}"""
        first = self.reader.expect("{")
        kind = ""
        if self.reader.next.kind == "name" and self.reader.after.text == ":":
            kind = self.reader.take().text.upper()
            self.reader.expect(":")
        items: list[Node] = []
        while True:
            name = self.reader.kind("name", "the name of a component")
            spelled = name.text.upper()
            if self.reader.accept("["):
                spelled += "[" + ("" if self.reader.next.text == "]" else self.expression().text) + "]"
                self.reader.expect("]")
            value = self.expression()
            if any(item.text == spelled for item in items):
                raise refusal(f"{name.text} is given twice", name)
            items.append(Node("keyword", spelled, name.start, value.end, name.line, (value,)))
            if not self.reader.accept(","):
                break
        return Node("list", kind, first.start, self.reader.expect("}").end, first.line, tuple(items))


def krl_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the target that an aggregate of a type states, or why it is left alone.

    Raises:
        InputError: it has components that the type has not.
    """
    if value.kind != "list":
        return Left(name, value.line, "is computed")
    given = {item.text: item.items[0] for item in value.items}
    wanted = JOINTS if kind in AXES else PLACE
    allowed = {*wanted, *EXTERNAL} | ({"S", "T"} if kind not in ("FRAME", *AXES) else set())
    odd = [item for item in value.items if item.text not in allowed]
    if odd:
        raise refusal(f"{name}: a {kind} has no component {odd[0].text}", odd[0].token)
    lacking = [one for one in wanted if one not in given]
    if lacking:
        return Left(name, value.line, f"does not give {', '.join(lacking)}: the robot keeps what it has of them")
    if any(given[one].kind != "number" for one in wanted):
        return Left(name, value.line, "is computed")
    said = {k: given[one] for k, one in enumerate(EXTERNAL, start=1) if one in given and given[one].kind == "number"}
    external = {k: External(float(item.text)) for k, item in said.items()}
    if kind in AXES:
        joints = tuple(_number(given[one], np.pi / 180) for one in wanted)
        return Target(name, value.line, joints, None, external=external)
    numbers = tuple(_number(given[one], 1e-3 if one in "XYZ" else np.pi / 180) for one in wanted)
    configuration = _configuration(name, [(one, given[one]) for one in ("S", "T") if one in given])
    return Target(name, value.line, numbers, "zyx", configuration, external=external)


def _configuration(name: str, flags: list[tuple[str, Node]]) -> KrlConfiguration | None:
    """S and T, as numbers or as bits."""
    for one, value in flags:
        if re.fullmatch(r"\d+|'[Bb][01]+'", value.text) is None:
            raise refusal(f"{name}: expected a whole number or bits such as 'B010' as {one}", value.token)
    if not flags:
        return None
    places = tuple(Flag(value.start, value.end, value.text) for _, value in flags)
    return KrlConfiguration(places, tuple(one for one, _ in flags))


def frame(value: Node) -> np.ndarray | None:
    """{X 1, Y 2, Z 3, A 0, B 0, C 0} as a transform; None where it is not made of numbers."""
    given = {item.text: item.items[0] for item in value.items} if value.kind == "list" else {}
    if any(one not in given or given[one].kind != "number" for one in PLACE):
        return None
    return pose_matrix([_number(given[one], 1e-3 if one in "XYZ" else np.pi / 180).value for one in PLACE], "zyx")


def krl_number(name: str) -> str:
    """TOOL_DATA[1] and BASE_DATA[1] as 1; others by their own name."""
    found = re.fullmatch(r"(?:TOOL|BASE)_DATA\[(\d+)\]", name)
    return found.group(1) if found else name


def root(name: str) -> str:
    return re.split(r"[\[.]", name, maxsplit=1)[0].upper()


def _number(item: Node, scale: float) -> Number:
    return Number(item.start, item.end, item.text, scale)


SUFFIXES = (".src", ".dat", ".sub")
TOKENS = re.compile(
    r"""(?P<blank>[ \t\f\0\x1a]+|\xef\xbb\xbf)|(?P<comment>;[^\r\n]*)|(?P<newline>\r\n|\r|\n)|(?P<string>"[^"\r\n]*")"""
    r"""|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![A-Za-z0-9_.$]))|(?P<bits>'[Bb][01]+'|'[Hh][0-9A-Fa-f]+')"""
    r"""|(?P<name>[A-Za-z_$][A-Za-z0-9_$]*)|(?P<enum>\#[A-Za-z_$][A-Za-z0-9_$]*)"""
    r"""|(?P<symbol>==|<>|<=|>=|[-+*/=<>:,.()\[\]{}&?!@%])""",
    re.VERBOSE,
)
MOVES = ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL")
RELATIVE = ("PTP_REL", "LIN_REL", "CIRC_REL", "SPTP_REL", "SLIN_REL", "SCIRC_REL", "SPL_REL")
ENDS = {"DEF": "END", "DEFFCT": "ENDFCT", "DEFDAT": "ENDDAT"}
BLOCKS = {
    "IF": ("ENDIF",), "FOR": ("ENDFOR",), "WHILE": ("ENDWHILE",), "LOOP": ("ENDLOOP",), "REPEAT": ("UNTIL",),
    "SWITCH": ("ENDSWITCH",), "SPLINE": ("ENDSPLINE",), "PTP_SPLINE": ("ENDSPLINE",),
}  # fmt: skip
NULL_FRAME, WORLD = "$NULLFRAME", "$WORLD"
STANDING = "standing"  # a tool beside the robot, which has the work piece


def is_krl(text: str) -> bool:
    """Return whether a text begins as a KRL module or data list does."""
    begins = r"(?:\xef\xbb\xbf)?(?:\s|;[^\r\n]*|&[^\r\n]*)*(?:GLOBAL\s+)?(?:DEF|DEFFCT|DEFDAT)\s"
    return re.match(begins, text, re.IGNORECASE) is not None


def read_krl(source: bytes) -> Program:
    """Read a module or a data list.

    Raises:
        InputError: it is not KRL as this reads it, with the line.
    """
    text = source.decode("latin-1")
    header = re.match(r"(?:\xef\xbb\xbf)?(?:[ \t]*(?:[&;][^\r\n]*)?(?:\r\n|\r|\n))*", text)
    begun = header.end() if header else 0
    blanked = re.sub(r"[^\r\n]", " ", text[:begun]) + text[begun:]
    file = _File(Reader(scan(blanked, TOKENS), str.upper))
    file.read()
    return file.program(source)


@dataclass(frozen=True)
class _Use:
    """Tool and base with which a move goes to a target; None where the program does not say."""

    tool: str | None
    frame: str | None


@dataclass
class _File:
    """What is gathered on the way through a file; tool and frame are those in force."""

    reader: Reader
    values: KrlValues = field(init=False)
    types: dict[str, str] = field(default_factory=dict)
    targets: list[tuple[str, Target]] = field(default_factory=list)
    left: list[Left] = field(default_factory=list)
    uses: dict[str, list[_Use]] = field(default_factory=dict)
    gone_to: dict[str, Left] = field(default_factory=dict)
    move_data: dict[str, Node] = field(default_factory=dict)
    tools: dict[str, np.ndarray | None] = field(default_factory=dict)
    frames: dict[str, np.ndarray | None] = field(default_factory=dict)
    now: _Use = _Use(None, None)

    def __post_init__(self) -> None:
        self.values = KrlValues(self.reader)

    def read(self) -> None:
        """Blocks of DEF, DEFFCT and DEFDAT, one after the other."""
        self.reader.blank()
        while self.reader.next.kind != "end":
            self.reader.accept("GLOBAL")
            opening = self.reader.expect(*ENDS).text.upper()
            if opening == "DEFFCT":
                self.reader.kind("name", "the function's type")
                self.indices()
            self.reader.kind("name", f"the name after {opening}")
            if opening == "DEFDAT":
                self.reader.accept("PUBLIC")
            else:
                self.parameters()
            self.reader.end_of_line()
            self.now = _Use(None, None)
            self.body(ENDS[opening], opening == "DEFDAT")
            if self.reader.next.kind != "end":
                self.reader.end_of_line()

    def indices(self) -> None:
        """[], [3] or [3,4] after a name."""
        if self.reader.accept("["):
            while not self.reader.accept("]"):
                if self.reader.next.text != ",":
                    self.values.expression()
                self.reader.accept(",") or self.reader.next.text == "]" or self.reader.expect("]")

    def parameters(self) -> None:
        """(name :IN, name[] :OUT)"""
        self.reader.expect("(")
        while not self.reader.accept(")"):
            self.reader.kind("name", "a parameter")
            self.indices()
            self.reader.expect(":")
            self.reader.expect("IN", "OUT")
            if self.reader.next.text != ")":
                self.reader.expect(",", ")")

    def body(self, end: str, data: bool) -> None:
        """Statements up to the word that ends them."""
        self.reader.blank()
        while not self.reader.accept(end):
            word = self.reader.word
            if self.reader.next.kind == "end" or word in ENDS or word in ENDS.values():
                raise refusal(f"expected {end}, found {self.reader.next}", self.reader.next)
            self.statement(data)

    def block(self, end: str) -> None:
        """Statements of IF, FOR and the like: what they set of tool and base holds inside alone."""
        before = self.now
        self.body(end, False)
        changed = _Use(
            before.tool if self.now.tool == before.tool else None,
            before.frame if self.now.frame == before.frame else None,
        )
        self.now = changed

    def statement(self, data: bool) -> None:
        """A line, or a block of lines."""
        word = self.reader.word
        if word in BLOCKS and self.reader.after.text != "=" and not data:
            self.control(word)
        elif word in ("ELSE", "CASE", "DEFAULT") and not data:
            self.branch(word)
        elif word in MOVES and self.reader.after.text != "=":
            self.reader.take()
            self.motion(word)
        elif word in RELATIVE and self.reader.after.text != "=":
            line = self.reader.take().line
            self.left.append(Left(f"{word} in line {line}", line, "is relative to where the robot is"))
            self.loose()
        elif word == "GLOBAL" and self.reader.after.text.upper() == "INTERRUPT":
            self.loose()
        elif self.declared():
            self.declaration()
        elif self.reader.next.kind == "name" and word not in self.plain():
            self.assignment_or_call()
        else:
            self.loose()
        if word not in BLOCKS or data:
            self.reader.end_of_line()

    @staticmethod
    def plain() -> tuple[str, ...]:
        """Words whose lines hold no target: they are read for their brackets alone."""
        return (
            "EXT", "EXTFCT", "IMPORT", "ENUM", "STRUC", "INTERRUPT", "TRIGGER", "WAIT", "SIGNAL", "ANIN", "ANOUT", "DIGIN", "PULSE",
            "GOTO", "EXIT", "RETURN", "HALT", "CONTINUE", "BRAKE", "RESUME", "CHANNEL", "CWRITE", "CREAD", "CONST",
            "ASYPTP", "TIME_BLOCK", "CONST_VEL", "STOP", "ON_ERROR_PROCEED", "INI",
        )  # fmt: skip

    def loose(self) -> None:
        """The rest of a line, of which only brackets and words are read."""
        closing: list[str] = []
        while self.reader.next.kind not in ("newline", "end"):
            token = self.reader.take()
            if token.text in ("(", "[", "{"):
                closing.append({"(": ")", "[": "]", "{": "}"}[token.text])
            elif token.text in (")", "]", "}") and (not closing or closing.pop() != token.text):
                raise refusal(f"unexpected '{token.text}'", token)
        if closing:
            raise refusal(f"expected '{closing[-1]}', found {self.reader.next}", self.reader.next)

    def control(self, word: str) -> None:
        """IF ... THEN ... ENDIF, and the others."""
        opening = self.reader.take()
        if word == "IF":
            self.values.expression()
            self.reader.expect("THEN")
        elif word in ("WHILE", "SWITCH"):
            self.values.expression()
        else:
            self.loose()
        self.reader.end_of_line()
        self.block(BLOCKS[word][0])
        if word == "REPEAT":
            self.values.expression()
        else:
            self.loose()
        if self.reader.next.kind == "end":
            raise refusal(f"{opening.text} in line {opening.line} is followed by no END", self.reader.next)
        self.reader.end_of_line()

    def branch(self, word: str) -> None:
        """ELSE, CASE a, b and DEFAULT: what was set of tool and base before it does not hold."""
        self.reader.take()
        self.now = _Use(None, None)
        if word == "CASE":
            self.values.expression()
            while self.reader.accept(","):
                self.values.expression()

    def declared(self) -> bool:
        """Whether a declaration comes: DECL, GLOBAL, CONST, or a type and a name."""
        word = self.reader.word
        if word in ("DECL", "GLOBAL", "CONST"):
            return True
        return self.reader.next.kind == "name" and self.reader.after.kind == "name" and word not in self.plain()

    def declaration(self) -> None:
        """DECL GLOBAL CONST type name[3], name = value"""
        while self.reader.accept("DECL", "GLOBAL", "CONST"):
            pass
        if self.reader.word in ("ENUM", "STRUC", "SIGNAL", "INTERRUPT", "EXT", "EXTFCT", "CHANNEL"):
            self.loose()
            return
        kind = self.reader.kind("name", "a data type").text.upper()
        self.indices()
        while True:
            name = self.values.reference()
            if name.kind != "name":
                raise refusal(f"expected a name to declare, found '{name.text}(…)'", name.token)
            self.types[root(name.text)] = kind
            if self.reader.accept("="):
                self.given(name, kind, self.values.expression())
            if not self.reader.accept(","):
                break

    def assignment_or_call(self) -> None:
        """name = value, or name(arguments)"""
        to = self.values.reference()
        if self.reader.accept("="):
            self.given(to, self.types.get(root(to.text), ""), self.values.expression())
        elif to.kind == "call":
            self.called(to)
        elif self.reader.accept(":"):  # a label
            pass
        elif self.reader.next.kind not in ("newline", "end"):
            raise refusal(f"expected '=' or '(' after {to.text}, found {self.reader.next}", self.reader.next)

    def given(self, to: Node, kind: str, value: Node) -> None:
        """Take what is given to a name."""
        name = to.text.upper()
        if name in ("$TOOL", "$BASE"):
            self.in_force(name, value)
        elif name.startswith(("TOOL_DATA[", "BASE_DATA[")) and name.endswith("]"):
            own = self.tools if name.startswith("TOOL") else self.frames
            own[name] = None if name in own else frame(value)
        elif kind == "FDAT":
            self.move_data[name] = value
        elif name == "FDAT_ACT" and value.kind == "name":
            self.now = self.of_move_data(value.text.upper()) or _Use(None, None)
        elif kind in (*POSES, *AXES):
            if "." in name:
                self.left.append(
                    Left(to.text, to.line, "changes a part of a target on the way: what it makes of it is not known")
                )
            else:
                self.point(to.text, kind, value)
        elif kind == "" and value.kind == "list" and value.text in (*POSES, *AXES):
            self.point(to.text, value.text, value)
        elif kind == "" and value.kind == "list" and {item.text for item in value.items} >= {*PLACE, "S", "T"}:
            self.point(to.text, "E6POS", value)
        elif value.kind == "list" and {item.text for item in value.items} >= {*PLACE}:
            said = f"is a {kind}" if kind else "is not declared in this file"
            self.left.append(Left(to.text, to.line, f"reads like a target, and {said}"))

    def in_force(self, name: str, value: Node) -> None:
        """Take a new $TOOL or $BASE."""
        if value.kind == "name" and value.text.upper() in (NULL_FRAME, WORLD):
            known: str | None = "0"
        elif value.kind == "name":
            known = krl_number(value.text.upper())
        elif (matrix := frame(value)) is not None:
            known = f"{name} of line {value.line}"
            (self.tools if name == "$TOOL" else self.frames)[known] = matrix
        else:
            known = None
        self.now = replace(self.now, tool=known) if name == "$TOOL" else replace(self.now, frame=known)

    def called(self, call: Node) -> None:
        """BAS(#TOOL, 1) and BAS(#BASE, 1) set what is in force."""
        if call.text.upper() == "BAS" and len(call.items) == 2 and call.items[1].kind == "number":
            what, number = call.items[0].text.upper(), call.items[1].text
            if what in ("#TOOL", "#BASE"):
                self.now = replace(self.now, tool=number) if what == "#TOOL" else replace(self.now, frame=number)

    def motion(self, word: str) -> None:
        """PTP target C_PTP, LIN target, CIRC target, target, CA 90; with the rest of the line."""
        line = self.reader.last.line
        for k in range(2 if word in ("CIRC", "SCIRC") else 1):
            if k:
                self.reader.expect(",")
            place = self.values.expression()
            if place.kind == "list":
                own = f"{word} in line {line}" + (", end" if k else "")
                kind = place.text or ("E6AXIS" if any(item.text in JOINTS for item in place.items) else "E6POS")
                if kind not in (*POSES, *AXES):
                    raise refusal(f"expected a target, found a {kind}", place.token)
                self.point(own, kind, place)
                self.uses.setdefault(own.upper(), []).append(self.now)
            elif place.kind == "name":
                self.uses.setdefault(place.text.upper(), []).append(self.now)
                self.gone_to.setdefault(place.text.upper(), Left(place.text, line, ""))
            else:
                self.left.append(Left(f"{word} in line {line}", line, "goes to a place that is computed"))
        self.loose()

    def point(self, name: str, kind: str, value: Node) -> None:
        """Take a target, or why it is left alone."""
        found = krl_target(name, kind, value)
        self.targets.append((kind, found)) if isinstance(found, Target) else self.left.append(found)

    def of_move_data(self, name: str) -> _Use | None:
        """Tool and base of an FDAT; None where it is not in this file."""
        data = self.move_data.get(name)
        if data is None:
            return None
        given = {item.text: item.items[0] for item in data.items}
        if "IPO_FRAME" in given and given["IPO_FRAME"].text.upper() == "#TCP":
            return _Use(STANDING, None)
        numbers = [
            given[one].text if one in given and given[one].kind == "number" else None for one in ("TOOL_NO", "BASE_NO")
        ]
        return _Use(numbers[0], numbers[1])

    def program(self, source: bytes) -> Program:
        """All that was found, with tool and base of each target."""
        targets = []
        for kind, target in self.targets:
            key = target.name.upper()
            own = self.of_move_data("F" + key[1:]) if key.startswith("X") else None
            uses = [own] if own else self.uses.get(key, [])
            if any(use.tool == STANDING for use in uses):
                self.left.append(Left(target.name, target.line, "is of a tool that stands still"))
                continue
            if kind == "FRAME" and not uses:
                self.left.append(Left(target.name, target.line, "is a FRAME to which no move of this file goes"))
                continue
            tools = tuple(dict.fromkeys(use.tool for use in uses if use.tool is not None))
            frames = tuple(dict.fromkeys(use.frame for use in uses if use.frame is not None))
            targets.append(replace(target, tools=tools, frames=frames) if target.turn else target)
        stated = {target.name.upper() for target in targets} | {left.name.upper() for left in self.left}
        self.left += [
            replace(one, reason="is gone to, and its numbers do not stand in this file")
            for name, one in self.gone_to.items() if name not in stated
        ]  # fmt: skip
        places = {one.start for target in targets for one in target.numbers}
        lines = {one.line for one in self.left}
        self.left += [
            Left(f"target in line {one.line}", one.line, "stands in an expression: where it leads is not known")
            for one in self.values.literals
            if not any(item.items[0].start in places for item in one.items) and one.line not in lines
        ]
        known = (
            {krl_number(name): matrix for name, matrix in own.items() if matrix is not None}
            for own in (self.tools, self.frames)
        )
        tools_known, frames_known = known
        left = tuple(sorted(self.left, key=lambda one: one.line))
        return Program(
            "krl", source, tuple(targets), left, {"0": NOWHERE, **tools_known}, {"0": NOWHERE, **frames_known}
        )
