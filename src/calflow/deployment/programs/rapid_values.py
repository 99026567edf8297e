"""RAPID's values: its expressions, and targets, tools and work objects as it writes them."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from calflow.deployment.programs.configuration import Flag, RapidConfiguration
from calflow.deployment.programs.expression import Expressions, Node
from calflow.deployment.programs.orientation import pose_matrix
from calflow.deployment.programs.scanner import Reader, refusal
from calflow.deployment.programs.target import External, Left, Number, Target

UNIT_LENGTH = 1e-3  # by how much a quaternion's length may differ from 1, as the maker allows
EXTERNAL = 6  # values of external axes that a target has
NOT_THERE = 8.9e9  # an external axis that there is not has 9E9


class RapidValues(Expressions):
    """RAPID's expressions."""

    binary = frozenset({"+", "-", "*", "/", "DIV", "MOD", "=", "<>", "<", ">", "<=", ">=", "AND", "OR", "XOR"})
    unary = frozenset({"+", "-", "NOT"})

    def __init__(self, reader: Reader) -> None:
        super().__init__(reader)
        self.literals: list[Node] = []  # all that have the shape of a target, wherever they stand

    def value(self) -> Node:
        token = self.reader.next
        if token.text == "[" and token.kind == "symbol":
            found = self.listed("[", "]")
            if [len(item.items) for item in found.items] in ([3, 4, 4, EXTERNAL], [6, EXTERNAL]):
                self.literals.append(found)
            return found
        if token.text == "<" and self.reader.after.kind == "name":  # a place left open, such as <EXP>
            self.reader.take()
            self.reader.take()
            return Node("computed", "", token.start, self.reader.expect(">").end, token.line)
        if token.kind == "name":
            return self.reference()
        return super().value()

    def reference(self) -> Node:
        """A variable, with its indices and components, or a call."""
        first = self.reader.kind("name", "a name")
        text, inner = first.text, list[Node]()
        while True:
            if self.reader.next.text == "{":
                index = self.listed("{", "}")
                text += "{" + ",".join(item.text for item in index.items) + "}"
                inner += index.items
            elif self.reader.next.text == "." and self.reader.accept("."):
                text += "." + self.reader.kind("name", "the name of a component").text
            elif self.reader.next.text == "(":
                self.reader.take()
                items = self.arguments(")")
                return Node("call", text, first.start, self.reader.expect(")").end, first.line, tuple(items))
            else:
                return Node("name", text, first.start, self.reader.last.end, first.line, tuple(inner))

    def arguments(self, closing: str) -> list[Node]:
        """Arguments up to what closes them: `a, b \\Switch, c \\Option:=d`."""
        found: list[Node] = []
        while self.reader.next.text != closing:
            if self.reader.accept("\\"):
                name = self.reader.kind("name", "the name of an optional argument")
                value = (self.expression(),) if self.reader.accept(":=") else ()
                found.append(Node("keyword", name.text, name.start, self.reader.last.end, name.line, value))
            else:
                found.append(self.expression())
            if self.reader.next.text != "\\":
                if self.reader.next.text == closing:
                    break
                self.reader.expect(",", "\\", closing)
                if self.reader.next.text == closing:
                    raise refusal(f"expected a value, found '{closing}'", self.reader.next)
        return found


def stated_target(name: str, kind: str, value: Node) -> Target | Left:
    """Return the robtarget or jointtarget that a value states, or why it is left alone.

    Raises:
        InputError: it has not the shape of one.
    """
    computed = Left(name, value.line, "is computed")
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
    said = {k: External(float(item.text)) for k, item in enumerate(groups[-1].items, start=1)}
    external = {k: one for k, one in said.items() if abs(one.value) < NOT_THERE}
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


def frames(stated: Iterable[tuple[str, str, Node]]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], list[Left]]:
    """Tools and work objects that are stated once, by numbers; what else there is of them is left to the user."""
    found: dict[str, dict[str, np.ndarray | None]] = {"tooldata": {}, "wobjdata": {}}
    left = []
    for name, kind, value in stated:
        matrix = _tool(value) if kind == "tooldata" else _work_object(value)
        again = name.lower() in found[kind]
        if matrix is None or again:
            left.append(
                Left(
                    name,
                    value.line,
                    "is set more than once"
                    if again
                    else "is not stated by numbers alone, not held as usual, or has no quaternion of length 1",
                )
            )
        found[kind][name.lower()] = None if again else matrix
    known = ({name: matrix for name, matrix in own.items() if matrix is not None} for own in found.values())
    tools, frames = known
    return tools, frames, left


def _tool(value: Node) -> np.ndarray | None:
    """[TRUE, [[x, y, z], [q1, q2, q3, q4]], [load]] as a transform; None for a tool that does not move with the robot."""
    if len(value.items) != 3 or value.items[0].text.upper() != "TRUE":
        return None
    return _pose(value.items[1])


def _work_object(value: Node) -> np.ndarray | None:
    """[FALSE, TRUE, "", user frame, object frame] as a transform; None for one that moves."""
    if len(value.items) != 5 or [item.text.upper() for item in value.items[:3]] != ["FALSE", "TRUE", '""']:
        return None
    user, own = _pose(value.items[3]), _pose(value.items[4])
    return None if user is None or own is None else user @ own


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
