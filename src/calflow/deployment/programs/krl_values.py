"""KRL's values: its expressions with aggregates, and targets and frames as it writes them."""

from __future__ import annotations

import re

import numpy as np

from calflow.deployment.programs.configuration import Flag, KrlConfiguration
from calflow.deployment.programs.expression import Expressions, Node
from calflow.deployment.programs.orientation import pose_matrix
from calflow.deployment.programs.scanner import Reader, refusal
from calflow.deployment.programs.target import External, Left, Number, Target

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


def stated_target(name: str, kind: str, value: Node) -> Target | Left:
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


def numbered(name: str) -> str:
    """TOOL_DATA[1] and BASE_DATA[1] as 1; others by their own name."""
    found = re.fullmatch(r"(?:TOOL|BASE)_DATA\[(\d+)\]", name)
    return found.group(1) if found else name


def root(name: str) -> str:
    return re.split(r"[\[.]", name, maxsplit=1)[0].upper()


def _number(item: Node, scale: float) -> Number:
    return Number(item.start, item.end, item.text, scale)
