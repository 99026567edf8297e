"""RAPID: programs of ABB robots, read after the RAPID reference manual's grammar of modules, data and routines.

RAPID's values: its expressions, and targets, tools and work objects as it writes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.deployment.conventions import NOWHERE, pose_matrix
from calflow.programs.names import ALIAS, Declared, root
from calflow.programs.scanner import Expressions, Node, Reader, refusal, scan
from calflow.programs.statements import DEEPEST_NAME, Compound, Place, Statements
from calflow.programs.target import External, Flag, Left, Number, RapidConfiguration, Target, Use

UNIT_LENGTH = 1e-3  # by how much a quaternion's length may differ from 1, as the maker allows
EXTERNAL = 6  # values of external axes that a target has
PLACEHOLDER = 9e9
NOT_THERE = 8.9e9  # an external axis that there is not has 9E9


class RapidValues(Expressions):
    """RAPID's expressions."""

    binary = frozenset({"+", "-", "*", "/", "DIV", "MOD", "=", "<>", "<", ">", "<=", ">=", "AND", "OR", "XOR"})
    unary = frozenset({"+", "-", "NOT"})

    brackets = ("{", "}")

    def value(self) -> Node:
        token = self.reader.next
        if token.text == "[" and token.kind == "symbol":
            items = self.listed("[", "]")
            if [len(item.items) for item in items.items] in ([3, 4, 4, EXTERNAL], [6, EXTERNAL]):
                self.literals.append(items)
            return items
        if token.text == "<" and self.reader.after.kind == "name":  # a place left open, such as <EXP>
            self.reader.take()
            self.reader.take()
            return Node("computed", "", token.start, self.reader.expect(">").end, token.line)
        if token.kind == "name":
            return self.reference()
        return super().value()

    def arguments(self) -> tuple[Node, ...]:
        """Read a call's arguments in brackets."""
        self.reader.expect("(")
        arguments = self.arguments_to(")")
        self.reader.expect(")")
        return arguments

    def arguments_to(self, closing: str) -> tuple[Node, ...]:
        """Arguments up to what closes them: `a, b \\Switch, c \\Option:=d \\Option?parameter`."""
        arguments: list[Node] = []
        while self.reader.next.text != closing:
            if self.reader.accept("\\"):
                name = self.reader.kind("name", "the name of an optional argument")
                value: tuple[Node, ...] = ()
                if self.reader.accept(":="):
                    value = (self.expression(),)
                elif self.reader.accept("?"):  # what the routine was itself called with, if it was
                    passed = self.reference()
                    value = (replace(passed, text=f"?{passed.text}"),)
                arguments.append(Node("keyword", name.text, name.start, self.reader.last.end, name.line, value))
            else:
                arguments.append(self.expression())
            if self.reader.next.text not in ("\\", closing):
                self.reader.expect(",", "\\", closing)
                if self.reader.next.text == closing:
                    raise refusal(f"expected a value, found '{closing}'", self.reader.next)
        return tuple(arguments)


def rapid_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the robtarget or jointtarget that a value states, or why it is left alone.

    Raises:
        InputError: it has not the shape of one.
    """
    computed = Left(name, value.line, "computed", "is computed")
    if value.kind != "list":
        return computed
    sizes = (3, 4, 4, EXTERNAL) if kind == "robtarget" else (6, EXTERNAL)
    groups = value.items
    if len(groups) == len(sizes) and any(group.kind != "list" for group in groups):
        return computed
    if [len(group.items) for group in groups] != list(sizes):
        shape = ", ".join(f"[{size}]" for size in sizes)
        raise refusal(f"{name}: expected a {kind} of {len(sizes)} lists with {shape} values", value.token)
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
            raise refusal(f"{name}: expected a whole number in its configuration, found '{item.text}'", item.token)
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


def _number(item: Node, scale: float) -> Number:
    text = item.text if item.text[1:2].lower() not in ("x", "b", "o") else str(int(item.text, 0))
    return Number(item.start, item.end, text, scale)


SUFFIXES = (".mod", ".modx", ".sys", ".sysx", ".prg")
TOKENS = re.compile(
    r"""(?P<blank>[ \t\r\n\f\0\x1a]+|\ufeff|\xef\xbb\xbf)|(?P<comment>![^\r\n]*|%%%[^%]*%%%)|(?P<string>"(?:[^"\r\n]|"")*")"""
    r"""|(?P<number>0[xX][0-9A-Fa-f]+|0[bB][01]+|0[oO][0-7]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![A-Za-z0-9_.]))"""
    r"""|(?P<name>[A-Za-z\xc0-\xff][A-Za-z0-9_\xc0-\xff]*)|(?P<symbol>:=|<>|<=|>=|[-+*/=<>;:,.?|%\\()\[\]{}])""",
    re.VERBOSE,
)
POINTS = ("robtarget", "jointtarget")
ROUTINES = {"PROC": "name", "FUNC": "name name", "TRAP": "name"}  # what stands after the word, before the parameters
# How many targets come first.
PLACES_AT = {"MOVEJ": 1, "MOVEL": 1, "MOVEABSJ": 1, "MOVEC": 2}
JOINTWISE = re.compile("(?:MOVE|TRIGG|PAINT|ARC|SPOT)J")
MOVING = ("MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "DISP", "PAINT", "CALIB")
DISPLACING = ("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET")


def is_rapid(text: str) -> bool:
    """Return whether a text begins as a module does."""
    return re.match(r"(?:\xef\xbb\xbf)?(?:\s|![^\r\n]*|%%%[^%]*%%%)*MODULE\s", text, re.IGNORECASE) is not None


def read_rapid(source: bytes, file: str) -> Statements:
    """Read a file of modules.

    Raises:
        InputError: it is not RAPID as this reads it, with the line.
    """
    reader = Reader(scan(source.decode("latin-1"), TOKENS), str.upper)
    modules = _Modules(reader, RapidValues(reader), source, file, Declared(file))
    modules.module()
    while reader.next.kind != "end":
        modules.module()
    return modules


@dataclass
class _Modules(Statements):
    """What is gathered on the way through a file of modules.

    unwatched has ConfL and ConfJ, where the file switches them off; which moves come after that, only its run would tell.
    """

    values: RapidValues
    unwatched: set[str] = field(default_factory=set)

    maker, flange, base = "rapid", "tool0", "wobj0"
    sign, remark, lined = ":=", "!", False
    compounds = {
        "IF": Compound("", "ENDIF", {"ELSEIF": "value THEN", "ELSE": ""}),
        "FOR": Compound("name FROM value TO value [STEP value] DO", "ENDFOR"),
        "WHILE": Compound("value DO", "ENDWHILE"),
        "TEST": Compound("value", "ENDTEST", {"CASE": "values :", "DEFAULT": ":"}),
    }
    outer = ("ENDMODULE", *(f"END{word}" for word in ROUTINES))

    @staticmethod
    def folded(name: str) -> str:
        """Return a name in lower case."""
        return name.lower()

    def module(self) -> None:
        """MODULE name (attributes) ... ENDMODULE."""
        self.phrase("MODULE name [( names )]")
        while not self.reader.accept("ENDMODULE"):
            scope = self.reader.accept("LOCAL", "TASK")
            if self.reader.word in ("VAR", "PERS", "CONST"):
                self.data(private=scope is not None and scope.text.upper() == "LOCAL")
            elif self.reader.word == "RECORD" or self.reader.word == "ALIAS":
                self.definition()
            elif self.reader.word in ROUTINES:
                self.routine()
            elif self.reader.next.text == "<":
                self.phrase("< name >")
            else:
                expected = "data or a routine" if scope else "data, a routine or ENDMODULE"
                raise refusal(f"expected {expected}, found {self.reader.next}", self.reader.next)

    def data(self, private: bool) -> None:
        """VAR | PERS | CONST type name {dimensions} := value;"""
        first = self.reader.last if self.reader.folded(self.reader.last) in ("LOCAL", "TASK") else self.reader.next
        scope = self.reader.take().text.upper()
        if self.reader.word in ("LOCAL", "TASK"):
            raise refusal(f"expected a data type, found {self.reader.next}", self.reader.next)
        kind_token = self.reader.kind("name", "a data type")
        kind, head = kind_token.text.lower(), self.source[first.start : kind_token.start].decode("latin-1")
        given: list[tuple[str, int, Node]] = []
        while True:
            name = self.reader.kind("name", "the data's name")
            shape = self.values.listed("{", "}").items if self.reader.next.text == "{" else ()
            if scope == "CONST" and self.reader.next.text != ":=":
                raise refusal(f"expected ':=', found {self.reader.next}", self.reader.next)
            value = self.values.expression() if self.reader.accept(":=") else None
            self.declare(name.text, kind, private)
            if value:
                if scope == "CONST" or kind != "num":  # instructions count numbers on without an assignment
                    self.value_of(name.text.lower(), len(shape), value)
                given.append((name.text, len(shape), value))
            if not self.reader.accept(","):
                break
        end = self.reader.expect(";").end
        for text, dimensions, value in given:
            self.later(self.given, text, kind, dimensions, value, (first.start, head, end))

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
        elif kind in POINTS and (dimensions or self.place_given(name, value) is None):
            found = Left(name, value.line, "computed", "is computed") if dimensions else rapid_target(name, kind, value)
            declared = None
            if stands:
                start, head, end = stands
                declared = self.declared_as(start, f"{head}{kind} ", name, value, end, ";")
            self.take(found, declared=declared)
        elif kind in self.scope.project.components and value.kind == "list":
            for (part, inner), item in zip(self.scope.project.components[kind].items(), value.items, strict=False):
                self.given(f"{name}.{part}", inner, 0, item, stands)
        elif kind not in POINTS and [len(group.items) for group in value.items] in ([3, 4, 4, 6], [6, 6]):
            self.leave(name, value.line, "no move", f"reads like a target, and is a {kind}")

    def place_given(self, name: str, value: Node) -> Place | None:
        """The place that is computed from another target and given to a name, which has no other value."""
        alone = value.kind in ("call", "name") and self.scope.value(name.lower()) is value
        return self.place(value) if alone else None

    def definition(self) -> None:
        """RECORD name type component; ... ENDRECORD, or ALIAS type name;"""
        if self.reader.accept("ALIAS"):
            kind = self.reader.kind("name", "a data type").text.lower()
            self.declared.components[self.reader.kind("name", "a name").text.lower()][ALIAS] = kind
            self.reader.expect(";")
            return
        self.reader.expect("RECORD")
        name = self.reader.kind("name", "the record's name").text.lower()
        while not self.reader.accept("ENDRECORD"):
            kind = self.reader.kind("name", "a data type").text.lower()
            self.declared.components[name][self.reader.kind("name", "a component").text.lower()] = kind
            self.reader.expect(";")

    def routine(self) -> None:
        """PROC | FUNC | TRAP ... to its end."""
        opening = self.reader.folded(self.reader.take())
        self.phrase(ROUTINES[opening])
        if opening != "TRAP":
            self.parameters()
        while not self.reader.accept(f"END{opening}"):
            if self.reader.accept("ERROR", "UNDO", "BACKWARD"):
                self.phrase("[( values )]")
            else:
                self.statement()

    def parameters(self) -> None:
        """(type name, \\ type name {*} | type name, ...)"""
        self.reader.expect("(")
        while not self.reader.accept(")"):
            while self.reader.accept("\\", ",", "|"):
                pass
            self.reader.accept("VAR", "PERS", "INOUT")
            kind = self.reader.kind("name", "a parameter's type").text.lower()
            if kind in ("switch",) or self.reader.next.kind == "name":
                self.declare(self.reader.kind("name", "a parameter's name").text, kind, private=True)
            if self.reader.accept("{"):
                self.reader.expect("*")
                while self.reader.accept(","):
                    self.reader.expect("*")
                self.reader.expect("}")
            if self.reader.next.text not in (",", "|", ")", "\\"):
                self.reader.expect(",", ")")

    def statement(self) -> None:
        """A statement of a routine, with all that is inside it."""
        token, word = self.reader.next, self.reader.word
        if word in ("VAR", "PERS", "CONST"):
            self.data(private=True)
        elif word == "IF":
            self.condition()
        elif word in self.compounds:
            self.compound(word)
        elif self.reader.next.text == "<":
            self.phrase("< name > [;]")
        elif self.reader.accept(";"):
            pass
        elif self.reader.accept("RETURN", "RAISE", "GOTO"):
            if self.reader.next.text != ";":
                self.values.expression()
            self.reader.expect(";")
        elif word == "CONNECT":
            self.phrase("CONNECT value WITH value ;")
        elif word == "%":
            self.phrase("% value %")
            self.instruction_arguments(Node("name", "%", token.start, token.end, token.line))
        else:
            self.assignment_or_instruction()

    def condition(self) -> None:
        """IF condition THEN ... ELSEIF ... ELSE ... ENDIF, or IF condition instruction;"""
        self.phrase("IF value")
        if self.reader.next.text.upper() == "THEN":
            self.compound("IF")
        else:
            self.statement()

    def assignment_or_instruction(self) -> None:
        """name := value; or Instruction a, b \\Option:=c; or a label:"""
        first = self.values.reference()
        if self.reader.accept(":="):
            self.assigned(first, self.values.expression())
            self.reader.expect(";")
        elif self.reader.next.text == ":" and first.kind == "name":
            self.reader.take()
        elif first.kind == "call":  # one argument, in brackets
            self.reader.expect(";")
            self.later(self.move, first, first.items)
        else:
            self.instruction_arguments(first)

    def instruction_arguments(self, name: Node) -> None:
        """The arguments of an instruction and its end."""
        arguments = self.values.arguments_to(";")
        self.reader.expect(";")
        switched = name.text.upper()
        if switched in ("CONFL", "CONFJ") and "OFF" in {argument.text.upper() for argument in arguments}:
            self.unwatched.add(switched)
        self.later(self.move, name, arguments)

    def assigned(self, to: Node, value: Node) -> None:
        """Take what a routine gives to a name."""
        name, _, component = to.text.lower().partition(".")
        fixed = all(item.kind == "number" for item in to.items)
        given = replace(value, kind="computed") if component else value
        self.declared.values[name if fixed else root(name)].append(given)
        self.later(self.assign, to, value)

    def assign(self, to: Node, value: Node) -> None:
        """Take a target that a routine gives to a name."""
        kind, whole = self.scope.type_of(to.text.lower()), to.text.rpartition(".")
        if kind in POINTS:
            self.given(to.text, kind, 0, value)
        elif any(self.scope.type_of(part) in POINTS for part in _wholes(whole[0].lower())):
            self.left.append(
                Left(
                    to.text,
                    to.line,
                    "changed on the way",
                    f"changes {to.text.partition('.')[2]} of a target on the way: what it makes of it is not known",
                )
            )

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
                self.left.append(Left(name, values[0].line, "tool or frame", why))
            yield "tool" if kind == "tooldata" else "frame", self.scope.label(name), matrix

    def move(self, name: Node, arguments: Iterable[Node]) -> None:
        """Take what an instruction says of the targets that it names."""
        instruction = name.text.upper()
        whole = Node("call", name.text, name.start, name.end, name.line, tuple(arguments))
        places = whole.arguments
        if instruction in DISPLACING:
            self.left.append(
                Left(name.text, name.line, "shared", "displaces what follows: it is corrected as if it did not")
            )
        if not instruction.startswith(MOVING):
            return
        at = 4 if instruction.startswith("MOVEC") else 3 if instruction.startswith("MOVE") else len(places) - 1
        tool = places[at].text if 0 <= at < len(places) and places[at].kind == "name" else ""
        frame = whole.keyword("wobj")
        watched = ("CONFJ" if JOINTWISE.match(instruction) else "CONFL") not in self.unwatched
        use = Use(tool.lower(), frame.text.lower() if frame else "wobj0", flagged=watched)
        for k, value in enumerate(places):
            if instruction.startswith("SEARCH") and k == 1:  # the place that it finds
                continue
            if k < PLACES_AT.get(instruction, 0) or self.is_literal(value) or self.of_point(value):
                self.go_to(value, use)

    def go_to(self, value: Node, use: Use) -> None:
        """Take where an argument of a move leads."""
        name = {"name": value.text, "call": f"{value.text}(…)"}.get(value.kind, f"target in line {value.line}")
        place = self.place(value)
        if place is not None:
            use = self.go(place, value, name, value.line, use)
            if place.origin.kind == "list":
                kind = "robtarget" if len(place.origin.items) == 4 else "jointtarget"
                self.take(rapid_target(name, kind, place.origin), use)
        elif value.kind == "call":
            self.left.append(Left(name, value.line, "computed", "is computed"))

    def place(self, value: Node, depth: int = 0) -> Place | None:
        """A target by its name or its numbers, or what Offs or RelTool make of one."""
        if self.is_literal(value):
            return Place(value)
        if value.kind == "name":
            given = self.scope.value(value.text.lower()) if depth < DEEPEST_NAME else None
            follows = given is not None and given.kind in ("name", "call")
            return (self.place(given, depth + 1) if given is not None and follows else None) or Place(value)
        if value.kind != "call" or not value.items:
            return None
        function = value.text.upper()
        inner = self.place(value.items[0], depth + 1) if function in ("OFFS", "RELTOOL") else None
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

    @staticmethod
    def is_literal(value: Node) -> bool:
        """Whether a value in a move has the shape of a target."""
        return value.kind == "list" and len(value.items) in (2, 4) and all(item.kind == "list" for item in value.items)

    def of_point(self, value: Node) -> bool:
        """Whether a value is a target's name, or has one in it."""
        return any(self.scope.type_of(node.text.lower()) in POINTS for node in value.walk())


def _indexed(name: str, k: int) -> str:
    return f"{name[:-1]},{k}}}" if name.endswith("}") else f"{name}{{{k}}}"


def _wholes(name: str) -> Iterator[str]:
    """A name of components, and all that it is a part of."""
    while name:
        yield name
        name = name.rpartition(".")[0]
