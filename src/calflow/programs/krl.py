"""KRL: programs of KUKA robots, module (.src) and data list (.dat), read after the KRL reference guide, a statement a line.

KRL's values: its expressions with aggregates, and targets and frames as it writes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from calflow.deployment.conventions import NOWHERE, pose_matrix
from calflow.programs.names import SHARED, Declared, root
from calflow.programs.scanner import Expressions, Node, Reader, refusal, scan
from calflow.programs.statements import DEEPEST_NAME, STANDING, Compound, Place, Statements
from calflow.programs.target import Declaration, External, Flag, KrlConfiguration, Left, Number, Target, Use

POSES, AXES = ("POS", "E3POS", "E6POS", "FRAME"), ("AXIS", "E3AXIS", "E6AXIS")
PLACE, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = tuple(f"E{k}" for k in range(1, 7))


class KrlValues(Expressions):
    """KRL's expressions, with aggregates `{TYPE: NAME value, ...}`; a component's text is its name, its item the value."""

    binary = frozenset(
        {"+", "-", "*", "/", "==", "<>", "<", ">", "<=", ">=", ":", "AND", "OR", "EXOR", "B_AND", "B_OR", "B_EXOR"}
    )
    unary = frozenset({"+", "-", "NOT", "B_NOT"})

    def value(self) -> Node:
        token = self.reader.next
        if token.text == "{":
            aggregate = self.aggregate()
            if {item.text for item in aggregate.items} >= {*PLACE, "S", "T"}:
                self.literals.append(aggregate)
            return aggregate
        if token.kind in ("enum", "bits"):
            self.reader.take()
            return Node("computed", token.text, token.start, token.end, token.line)
        if token.kind == "name":
            return self.reference()
        return super().value()

    def argument(self) -> Node:
        """An expression, or nothing between commas."""
        if self.reader.next.text in (",", ")", "]"):
            return Node("computed", "", self.reader.next.start, self.reader.next.start, self.reader.next.line)
        return self.expression()

    def aggregate(self) -> Node:
        """{TYPE: NAME value, NAME value}"""
        first = self.reader.expect("{")
        kind = ""
        if self.reader.next.kind == "name" and self.reader.after.text == ":":
            kind = self.reader.take().text.upper()
            self.reader.expect(":")
        items = self.reader.separated(self.component)
        for k, item in enumerate(items):
            if item.text in [item.text for item in items[:k]]:
                raise refusal(f"{item.text} is given twice", item.token)
        return Node("list", kind, first.start, self.reader.expect("}").end, first.line, tuple(items))

    def component(self) -> Node:
        """NAME value, or NAME[2] value"""
        name = self.reader.kind("name", "the name of a component")
        spelled = name.text.upper()
        if self.reader.next.text == "[":
            spelled += f"[{','.join(item.text for item in self.bracketed('[', ']', self.argument))}]"
        value = self.expression()
        return Node("keyword", spelled, name.start, value.end, name.line, (value,))


def krl_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the target that an aggregate of a type states, or why it is left alone.

    Raises:
        InputError: it has components that the type has not.
    """
    if value.kind != "list":
        return Left(name, value.line, "computed", "is computed")
    given = {item.text: item.items[0] for item in value.items}
    wanted = JOINTS if kind in AXES else PLACE
    allowed = {*wanted, *EXTERNAL} | ({"S", "T"} if kind not in ("FRAME", *AXES) else set())
    odd = [item for item in value.items if item.text not in allowed]
    if odd:
        raise refusal(f"{name}: a {kind} has no component {odd[0].text}", odd[0].token)
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
    if kind in AXES:
        joints = tuple(_number(given[name], np.pi / 180) for name in wanted)
        return Target(name, value.line, joints, None, external=external)
    numbers = tuple(_number(given[name], 1e-3 if name in "XYZ" else np.pi / 180) for name in wanted)
    configuration = _configuration(name, [(name, given[name]) for name in ("S", "T") if name in given])
    return Target(name, value.line, numbers, "zyx", configuration, external=external)


def _configuration(name: str, flags: list[tuple[str, Node]]) -> KrlConfiguration | None:
    """S and T, as numbers or as bits."""
    for flag, value in flags:
        if re.fullmatch(r"\d+|'[Bb][01]+'", value.text) is None:
            raise refusal(f"{name}: expected a whole number or bits such as 'B010' as {flag}", value.token)
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


SUFFIXES = (".src", ".dat", ".sub")
TOKENS = re.compile(
    r"""(?P<blank>[ \t\f\0\x1a]+|\xef\xbb\xbf)|(?P<comment>;[^\r\n]*)|(?P<newline>\r\n|\r|\n)|(?P<string>"[^"\r\n]*")"""
    r"""|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![A-Za-z0-9_.$]))|(?P<bits>'[Bb][01]+'|'[Hh][0-9A-Fa-f]+')"""
    r"""|(?P<name>[A-Za-z_$][A-Za-z0-9_$]*)|(?P<enum>\#[ \t]*[A-Za-z_$][A-Za-z0-9_$]*)"""
    r"""|(?P<symbol>==|<>|<=|>=|[-+*/=<>:,.()\[\]{}&?!@%])""",
    re.VERBOSE,
)
MOVES = ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL")
RELATIVE = ("PTP_REL", "LIN_REL", "CIRC_REL", "SPTP_REL", "SLIN_REL", "SCIRC_REL", "SPL_REL")
ENDS = {"DEF": "END", "DEFFCT": "ENDFCT", "DEFDAT": "ENDDAT"}
# Words whose lines hold no target: they are read for their brackets alone.
PLAIN = (
    "EXT", "EXTFCT", "IMPORT", "ENUM", "STRUC", "INTERRUPT", "TRIGGER", "WAIT", "SIGNAL", "ANIN", "ANOUT", "DIGIN", "PULSE",
    "GOTO", "EXIT", "RETURN", "HALT", "CONTINUE", "BRAKE", "RESUME", "CHANNEL", "CWRITE", "CREAD", "CONST",
    "ASYPTP", "TIME_BLOCK", "CONST_VEL", "STOP", "ON_ERROR_PROCEED", "INI",
)  # fmt: skip
TABLES = ("TOOL_DATA[", "BASE_DATA[")
CONFIGURATION = "$CONFIG"  # the data list whose names all files see
NULL_FRAME, WORLD = "$NULLFRAME", "$WORLD"


def is_krl(text: str) -> bool:
    """Return whether a text begins as a KRL module or data list does."""
    begins = r"(?:\xef\xbb\xbf)?(?:\s|;[^\r\n]*|&[^\r\n]*)*(?:GLOBAL\s+)?(?:DEF|DEFFCT|DEFDAT)\s"
    return re.match(begins, text, re.IGNORECASE) is not None


def read_krl(source: bytes, file: str) -> Statements:
    """Read a module or a data list.

    Raises:
        InputError: it is not KRL as this reads it, with the line.
    """
    text = source.decode("latin-1")
    header = re.match(r"(?:\xef\xbb\xbf)?(?:[ \t]*(?:[&;][^\r\n]*)?(?:\r\n|\r|\n))*", text)
    begun = header.end() if header else 0
    blanked = re.sub(r"[^\r\n]", " ", text[:begun]) + text[begun:]
    reader = Reader(scan(blanked, TOKENS), str.upper)
    read = _File(reader, KrlValues(reader), source, file, Declared(file.rpartition(".")[0].lower()))
    read.read()
    return read


@dataclass
class _File(Statements):
    """What is gathered on the way through a file."""

    values: KrlValues
    stated: dict[str, np.ndarray] = field(default_factory=dict)  # $TOOL and $BASE by what they are called
    gone: set[str] = field(default_factory=set)  # names to which moves go as they are
    routine: str = ""  # what is read
    data: bool = False  # whether it is a data list
    public: bool = False  # whether all files see what it declares

    maker, flange, base, remark = "krl", "0", "0", ";"
    compounds = {
        "IF": Compound("value THEN", "ENDIF", {"ELSE": ""}, "rest"),
        "FOR": Compound("rest", "ENDFOR", tail="rest"),
        "WHILE": Compound("value", "ENDWHILE", tail="rest"),
        "LOOP": Compound("rest", "ENDLOOP", tail="rest"),
        "REPEAT": Compound("rest", "UNTIL", tail="value"),
        "SWITCH": Compound("value", "ENDSWITCH", {"CASE": "values", "DEFAULT": ""}, "rest"),
        "SPLINE": Compound("rest", "ENDSPLINE", tail="rest"),
        "PTP_SPLINE": Compound("rest", "ENDSPLINE", tail="rest"),
    }
    outer = (*ENDS, *ENDS.values())

    @staticmethod
    def folded(name: str) -> str:
        """Return a name as KRL compares it."""
        return name.upper()

    def read(self) -> None:
        """Blocks of DEF, DEFFCT and DEFDAT, one after the other."""
        self.reader.blank()
        while self.reader.next.kind != "end":
            self.reader.accept("GLOBAL")
            opening = self.reader.folded(self.reader.expect(*ENDS))
            if opening == "DEFFCT":
                self.name()
                self.indices()
            self.routine = self.reader.word
            self.public = opening == "DEFDAT" and self.routine == CONFIGURATION
            self.name()
            if opening == "DEFDAT":
                self.reader.accept("PUBLIC")
            else:
                self.parameters()
            self.data = opening == "DEFDAT"
            self.later(self.enter, Use())
            self.body(ENDS[opening])
            self.reader.end_of_line()

    def indices(self) -> None:
        """[], [3] or [3,4] after a name."""
        if self.reader.next.text == "[":
            self.values.bracketed("[", "]", self.values.argument)

    def parameters(self) -> None:
        """(name :IN, name[] :OUT, name)"""
        self.reader.expect("(")
        while not self.reader.accept(")"):
            self.reader.kind("name", "a parameter")
            self.indices()
            if self.reader.accept(":"):
                self.reader.expect("IN", "OUT")
            if self.reader.next.text != ")":
                self.reader.expect(",", ")")

    def statement(self) -> None:
        """A line, or a block of lines."""
        word = self.reader.word
        if word in self.compounds and self.reader.after.text != "=" and not self.data:
            self.compound(word)
        elif word in MOVES and self.reader.after.text != "=":
            self.reader.take()
            self.motion(word)
        elif word in RELATIVE and self.reader.after.text != "=":
            line = self.reader.take().line
            self.left.append(Left(f"{word} in line {line}", line, "relative", "is relative to where the robot is"))
            self.rest()
        elif word == "GLOBAL" and self.reader.after.text.upper() == "INTERRUPT":
            self.rest()
        elif self.is_declared():
            self.declaration()
        elif self.reader.next.kind == "name" and word not in PLAIN:
            self.assignment_or_call()
        else:
            self.rest()
        self.reader.end_of_line()

    def is_declared(self) -> bool:
        """Whether a declaration comes: DECL, GLOBAL, CONST, or a type and a name."""
        word = self.reader.word
        if word in ("DECL", "GLOBAL", "CONST"):
            return True
        return self.reader.next.kind == "name" and self.reader.after.kind == "name" and word not in PLAIN

    def declaration(self) -> None:
        """DECL GLOBAL CONST type name[3], name = value"""
        start, words = self.reader.next.start, set[str]()
        while word := self.reader.accept("DECL", "GLOBAL", "CONST"):
            words.add(word.text.upper())
        if self.reader.word in ("ENUM", "STRUC", "SIGNAL", "INTERRUPT", "EXT", "EXTFCT", "CHANNEL"):
            self.rest()
            return
        kind = self.reader.kind("name", "a data type").text.upper()
        self.indices()
        given = self.reader.separated(lambda: self.declare(kind, "GLOBAL" in words, "CONST" in words))
        for name, value in given:
            if value:
                self.later(self.given, name, value, start, self.reader.last.end)

    def declare(self, kind: str, shared: bool, constant: bool) -> tuple[Node, Node | None]:
        """name[3] = value"""
        name = self.values.reference()
        if name.kind != "name":
            raise refusal(f"expected a name to declare, found '{name.text}(…)'", name.token)
        variable = root(name.text).upper()
        self.declared.types[variable] = kind
        if not (shared or self.public):
            self.declared.private.add(variable)
        value = self.values.expression() if self.reader.accept("=") else None
        if value and (constant or kind not in ("REAL", "INT")):
            self.declared.values[self.key(name.text)].append(value)
        return name, value

    def assignment_or_call(self) -> None:
        """name = value, or name(arguments)"""
        to = self.values.reference()
        if self.reader.accept("="):
            value = self.values.expression()
            whole, _, component = self.key(to.text).partition(".")
            fixed = all(item.kind == "number" for item in to.items)
            given = replace(value, kind="computed") if component else value
            self.declared.values[whole if fixed else root(whole)].append(given)
            if whole in ("$TOOL", "$BASE", "FDAT_ACT"):
                self.declared.setting.add(self.routine)
                self.declared.private.add(f"{whole} of line {value.line}")
            self.later(self.given, to, value, to.start if self.data else None, value.end)
        elif to.kind == "call":
            if _in_force(to):
                self.declared.setting.add(self.routine)
            elif self.key(to.text) != "BAS":
                self.declared.calls[self.routine].add(self.key(to.text))
            self.later(self.called, to)
        elif self.reader.accept(":"):  # a label
            pass
        elif self.reader.next.kind not in ("newline", "end"):
            raise refusal(f"expected '=' or '(' after {to.text}, found {self.reader.next}", self.reader.next)

    def given(self, to: Node, value: Node, start: int | None, end: int) -> None:
        """Take what is given to a name, in a data list from a byte start to an end."""
        name = self.key(to.text)
        kind = self.scope.type_of(root(name))
        spelled = {item.text for item in value.items} if value.kind == "list" else set()
        if name in ("$TOOL", "$BASE"):
            self.in_force(name, value)
        elif name == "FDAT_ACT" and value.kind == "name":
            self.now = self.of_move_data(self.key(value.text)) or Use()
        elif name.startswith(TABLES) or kind == "FDAT":
            pass
        elif kind in (*POSES, *AXES):
            if "." in name:
                self.left.append(
                    Left(
                        to.text,
                        to.line,
                        "changed on the way",
                        "changes a part of a target on the way: what it makes of it is not known",
                    )
                )
            else:
                words = "DECL GLOBAL" if self.shared(root(name)) else "DECL"
                declared = None if start is None else self.declared_as(start, f"{words} {kind} ", name, value, end)
                self.point(to.text, kind, value, declared)
        elif kind == "" and value.kind == "list" and value.text in (*POSES, *AXES):
            self.point(to.text, value.text, value)
        elif kind == "" and spelled >= {*PLACE, "S", "T"}:
            self.point(to.text, "E6POS", value)
        elif spelled >= {*PLACE}:
            if kind:
                self.left.append(Left(to.text, to.line, "no move", f"reads like a target, and is a {kind}"))
            else:
                self.left.append(
                    Left(to.text, to.line, "elsewhere", "reads like a target, and is not declared in this file")
                )

    def in_force(self, name: str, value: Node) -> None:
        """Take a new $TOOL or $BASE."""
        if value.kind == "name" and self.key(value.text) in (NULL_FRAME, WORLD):
            value_known: str | None = "0"
        elif value.kind == "name":
            value_known = krl_number(self.key(value.text))
        elif (matrix := frame(value)) is not None:
            value_known = f"{name} of line {value.line}"
            self.stated[value_known] = matrix
        else:
            value_known = None
        self.now = replace(self.now, tool=value_known) if name == "$TOOL" else replace(self.now, frame=value_known)

    def called(self, call: Node) -> None:
        """BAS(#TOOL, 1) and BAS(#BASE, 1) set what is in force; other routines that do leave it unknown."""
        if _in_force(call):
            what, number = call.items[0].text.upper(), call.items[1].text
            self.now = replace(self.now, tool=number) if what == "#TOOL" else replace(self.now, frame=number)
        elif self.key(call.text) in self.scope.project.setting:
            self.now = Use()

    def motion(self, word: str) -> None:
        """PTP target C_PTP, LIN target, CIRC target, target, CA 90; with the rest of the line."""
        line = self.reader.last.line
        for k in range(2 if word in ("CIRC", "SCIRC") else 1):
            if k:
                self.reader.expect(",")
            place = self.values.expression()
            if place.kind == "list" and _literal_kind(place) not in (*POSES, *AXES):
                raise refusal(f"expected a target, found a {_literal_kind(place)}", place.token)
            self.gone |= {self.key(place.text)} if place.kind == "name" else set()
            self.later(self.go_to, f"{word} in line {line}" + (", end" if k else ""), line, place)
        self.rest()

    def go_to(self, name: str, line: int, value: Node) -> None:
        """Take where a move leads."""
        place = self.place(value)
        if place is None:
            self.left.append(Left(name, line, "computed", "goes to a place that is computed"))
            return
        use = self.go(place, value, value.text if value.kind == "name" else name, line, self.now)
        if place.origin.kind == "list":
            self.take(krl_target(name, _literal_kind(place.origin), place.origin), use)

    def place(self, value: Node, depth: int = 0) -> Place | None:
        """A target by its name or its numbers, or what `:` makes of one and of frames that are known."""
        if value.kind == "list":
            return Place(value)
        if value.kind == "name":
            given = self.scope.value(self.key(value.text)) if depth < DEEPEST_NAME else None
            follows = given is not None and given.kind in ("name", "operation")
            return (self.place(given, depth + 1) if given is not None and follows else None) or Place(value)
        if value.kind == "operation" and not value.text:
            return self.place(value.items[0], depth + 1)
        if value.kind != "operation" or set(value.text.split()) != {":"}:
            return None
        points = [k for k, item in enumerate(value.items) if self.is_point(item)]
        if points != [0] and points != [len(value.items) - 1]:
            return None
        origin = self.place(value.items[points[0]], depth + 1)
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
        """Where a frame is that stands there or is given to a name, to which no move goes."""
        is_target = value.kind == "name" and self.key(value.text) in self.gone
        value_of = None if is_target else self.scope.value(self.key(value.text)) if value.kind == "name" else value
        return None if value_of is None else frame(value_of)

    def shared(self, name: str) -> bool:
        """Whether a name is one that all files see though the data list is not one of which they see all."""
        return not self.public and self.scope.owner(name) == SHARED

    def point(self, name: str, kind: str, value: Node, declared: Declaration | None = None) -> None:
        """Take a target, or why it is left alone."""
        follows = value.kind in ("name", "operation") and self.scope.value(self.key(name)) is value
        if follows and self.place(value) is not None:
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


def _in_force(call: Node) -> bool:
    """Whether a call is BAS(#TOOL, 1) or BAS(#BASE, 1)."""
    basic = call.text.upper() == "BAS" and len(call.items) == 2 and call.items[1].kind == "number"
    return basic and call.items[0].text.upper() in ("#TOOL", "#BASE")


def _literal_kind(value: Node) -> str:
    """The type of an aggregate in a move."""
    return value.text or ("E6AXIS" if any(item.text in JOINTS for item in value.items) else "E6POS")
