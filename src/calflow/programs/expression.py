"""Expressions: what stands for a value in a program, as far as it takes to know a number from a computation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from calflow.programs.scanner import Reader, Token, refusal

Kind = Literal["number", "string", "name", "call", "list", "pose", "keyword", "computed"]
DEEPEST = 60  # brackets within brackets: no program has more, and Python itself ends at a thousand


@dataclass(frozen=True)
class Node:
    """An expression: what it is, its text where it is a number or a name, its place, and what it is made of.

    A number may carry a sign. A call's text is the function's name and its items the arguments, a keyword's item its value.
    """

    kind: Kind
    text: str
    start: int
    end: int
    line: int
    items: tuple[Node, ...] = ()

    @property
    def token(self) -> Token:
        """Where it stands, for a refusal."""
        return Token("name", self.text, self.start, self.end, self.line)

    @property
    def arguments(self) -> tuple[Node, ...]:
        """The items that are not given by keyword."""
        return tuple(item for item in self.items if item.kind != "keyword")

    def keyword(self, name: str) -> Node | None:
        """The value given by a keyword (in lower case), if it is."""
        found = (item for item in self.items if item.kind == "keyword" and item.text.lower() == name)
        return next((item.items[0] for item in found if item.items), None)

    def walk(self) -> Iterator[Node]:
        """This and all that it is made of."""
        yield self
        for item in self.items:
            yield from item.walk()


class Expressions:
    """Reads expressions; a language says what its operators are and adds what else may stand for a value.

    Operators need no order here: whatever they make of their operands is computed, and so no target's number.
    """

    binary: frozenset[str] = frozenset()
    unary: frozenset[str] = frozenset({"+", "-"})

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self._depth = 0

    def expression(self) -> Node:
        """Read an expression.

        Raises:
            InputError: there is none.
        """
        self._depth += 1
        if self._depth > DEEPEST:
            raise refusal(f"more than {DEEPEST} brackets within each other", self.reader.next)
        found = self.operand()
        operands = [found]
        while self.reader.next.kind != "string" and self.reader.word in self.binary:
            self.reader.take()
            operands.append(self.operand())
        self._depth -= 1
        if len(operands) == 1:
            return found
        return Node("computed", "", found.start, operands[-1].end, found.line, tuple(operands))

    def operand(self) -> Node:
        """Read a value with its signs."""
        signs = []
        while self.reader.next.kind != "string" and self.reader.word in self.unary:
            signs.append(self.reader.take())
        value = self.value()
        if not signs:
            return value
        if value.kind == "number" and len(signs) == 1 and signs[0].text in "+-":
            return Node("number", signs[0].text + value.text, signs[0].start, value.end, signs[0].line)
        return Node("computed", "", signs[0].start, value.end, signs[0].line, (value,))

    def value(self) -> Node:
        """Read a number, a text, a name, or what is in brackets; languages add theirs.

        Raises:
            InputError: nothing of the sort comes next.
        """
        token = self.reader.next
        if token.kind in ("number", "string"):
            self.reader.take()
            return Node(
                "number" if token.kind == "number" else "string", token.text, token.start, token.end, token.line
            )
        if self.reader.accept("("):
            inner = self.expression()
            end = self.reader.expect(")").end
            return Node("computed", "", token.start, end, token.line, (inner,))
        raise refusal(f"expected a value, found {token}", token)

    def listed(self, opening: str, closing: str, kind: Kind = "list", text: str = "") -> Node:
        """Read expressions in brackets, separated by commas."""
        first = self.reader.expect(opening)
        items = []
        if not self.reader.accept(closing):
            items.append(self.expression())
            while self.reader.accept(","):
                items.append(self.expression())
            self.reader.expect(closing)
        return Node(kind, text, first.start, self.reader.last.end, first.line, tuple(items))
