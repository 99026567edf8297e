"""Scanning: a program's text as tokens with their places, and expressions as far as it takes to know a number from one computed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, TypeVar

from calflow.files.problems import InputError, Problem, shortened

Read = TypeVar("Read")
SKIPPED = ("blank", "comment")
LONGEST_SHOWN = 20  # characters of a program's own text that a message shows


class Token(NamedTuple):
    """A piece of a program: its kind, its text, the bytes [start, end) where it stands, and its line, from 1."""

    kind: str
    text: str
    start: int
    end: int
    line: int

    def __str__(self) -> str:
        return {"end": "the end of the file", "newline": "the end of the line"}.get(
            self.kind, f"'{shortened(self.text, LONGEST_SHOWN)}'"
        )


def refusal(message: str, token: Token) -> InputError:
    """Return the error that refuses a program at a token."""
    return InputError([Problem(message, line=token.line)])


def scan(text: str, pattern: re.Pattern[str]) -> list[Token]:
    """Return the tokens of a text, without blanks and comments, and one of kind `end` at its end.

    Args:
        text: the program, a character a byte.
        pattern: alternatives, each a group named after the kind of token that it matches.

    Raises:
        InputError: a character begins no token.
    """
    tokens: list[Token] = []
    place, line = 0, 1
    while place < len(text):
        match = pattern.match(text, place)
        if match is None or match.end() == place:
            raise refusal(f"unexpected character {text[place]!r}", Token("", "", place, place, line))
        kind, piece, end = match.lastgroup or "", match.group(), match.end()
        if kind not in SKIPPED:
            tokens.append(Token(kind, piece, place, end, line))
        if "\n" in piece or "\r" in piece:
            line += lines_in(piece)
        place = end
    return [*tokens, Token("end", "", place, place, line)]


def lines_in(text: str) -> int:
    """Return how many lines end in a text, whether with LF, CR or both."""
    return text.count("\n") + text.count("\r") - text.count("\r\n")


class Reader:
    """A place in a sequence of tokens."""

    def __init__(self, tokens: Sequence[Token], fold: Callable[[str], str] = str) -> None:
        self._tokens, self._fold, self._at = tokens, fold, 0
        self.next = tokens[0]  # the token to come; at the end it stays the last

    @property
    def after(self) -> Token:
        """The token after that."""
        return self._tokens[min(self._at + 1, len(self._tokens) - 1)]

    @property
    def last(self) -> Token:
        """The token that was taken last."""
        return self._tokens[max(self._at - 1, 0)]

    @property
    def word(self) -> str:
        """The text to come as the language compares it."""
        return self._fold(self.next.text)

    def folded(self, token: Token) -> str:
        """Return a token's text as the language compares it."""
        return self._fold(token.text)

    def take(self) -> Token:
        """Take the next token."""
        token = self.next
        self._at += 1
        self.next = self._tokens[min(self._at, len(self._tokens) - 1)]
        return token

    def accept(self, *texts: str) -> Token | None:
        """Take the next token if it reads like one of these, other than as a text in quotes."""
        return self.take() if self.next.kind != "string" and self.word in texts else None

    def expect(self, *texts: str) -> Token:
        """Take the next token, which must read like one of these.

        Raises:
            InputError: it does not.
        """
        token = self.accept(*texts)
        if token is None:
            expected = " or ".join(
                "the end of the line" if text in ("\n", "\r\n") else f"'{text}'" for text in texts[:6]
            )
            raise refusal(f"expected {expected}, found {self.next}", self.next)
        return token

    def kind(self, kind: str, meaning: str) -> Token:
        """Take the next token, which must be of a kind.

        Raises:
            InputError: it is not.
        """
        if self.next.kind != kind:
            raise refusal(f"expected {meaning}, found {self.next}", self.next)
        return self.take()

    def separated(self, read: Callable[[], Read]) -> list[Read]:
        """Read one or several of a kind, with commas between them."""
        items = [read()]
        while self.accept(","):
            items.append(read())
        return items

    def blank(self) -> None:
        """Take empty lines."""
        while self.next.kind == "newline":
            self.take()

    def end_of_line(self) -> None:
        """Take the end of a statement that ends with its line, and empty lines."""
        if self.next.kind != "end":
            self.kind("newline", "the end of the line")
        self.blank()


Kind = Literal["number", "string", "name", "call", "list", "pose", "keyword", "operation", "computed"]
DEEPEST = 60  # brackets within brackets: no program has more, and Python itself ends at a thousand


@dataclass(frozen=True)
class Node:
    """An expression: what it is, its text where it is a number or a name, its place, and what it is made of.

    A number may carry a sign. A call's text is the function's name and its items the arguments, a keyword's item its value, an
    operation's text its operators with blanks between them, none of a value in brackets.
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
        keywords = (item for item in self.items if item.kind == "keyword" and item.text.lower() == name)
        return next((item.items[0] for item in keywords if item.items), None)

    def same(self, other: Node) -> bool:
        """Whether another says the same, wherever it stands."""
        alike = (self.kind, self.text, len(self.items)) == (other.kind, other.text, len(other.items))
        return alike and all(item.same(another) for item, another in zip(self.items, other.items, strict=True))

    def walk(self) -> Iterator[Node]:
        """This and all that it is made of."""
        yield self
        for item in self.items:
            yield from item.walk()


class Expressions:
    """Reads expressions; a language says what its operators are and adds what else may stand for a value.

    Operators need no order here: whatever they make of their operands is no target's number.
    """

    binary: ClassVar[frozenset[str]]
    unary: ClassVar[frozenset[str]]
    brackets: ClassVar[tuple[str, str]] = ("[", "]")  # of indices

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.literals: list[Node] = []  # all that have the shape of a target, wherever they stand
        self._depth = 0

    def expression(self) -> Node:
        """Read an expression.

        Raises:
            InputError: there is none.
        """
        self._depth += 1
        if self._depth > DEEPEST:
            raise refusal(f"more than {DEEPEST} brackets within each other", self.reader.next)
        operand = self.operand()
        operands, operators = [operand], []
        while self.reader.next.kind != "string" and self.reader.word in self.binary:
            operators.append(self.reader.take().text)
            operands.append(self.operand())
        self._depth -= 1
        if not operators:
            return operand
        return Node("operation", " ".join(operators), operand.start, operands[-1].end, operand.line, tuple(operands))

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
        text = " ".join(sign.text for sign in signs)
        return Node("operation", text, signs[0].start, value.end, signs[0].line, (value,))

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
            return Node("operation", "", token.start, end, token.line, (inner,))
        raise refusal(f"expected a value, found {token}", token)

    def reference(self) -> Node:
        """Read a variable, with its indices and components, or a call."""
        first, inner = self.reader.kind("name", "a name"), list[Node]()
        text, (opening, closing) = first.text, self.brackets
        while True:
            if self.reader.next.text == opening:
                index = self.bracketed(opening, closing, self.argument)
                text += opening + ",".join(item.text for item in index) + closing
                inner += index
            elif self.reader.next.text == "." and self.reader.accept("."):
                text += "." + self.reader.kind("name", "the name of a component").text
            elif self.reader.next.text == "(":
                items = self.arguments()
                return Node("call", text, first.start, self.reader.last.end, first.line, items)
            else:
                return Node("name", text, first.start, self.reader.last.end, first.line, tuple(inner))

    def arguments(self) -> tuple[Node, ...]:
        """Read a call's arguments in brackets."""
        return self.bracketed("(", ")", self.argument)

    def argument(self) -> Node:
        """Read an argument, or an index: an expression, and what a language allows besides."""
        return self.expression()

    def listed(self, opening: str, closing: str, kind: Kind = "list", text: str = "") -> Node:
        """Read expressions in brackets, separated by commas."""
        first = self.reader.next
        items = self.bracketed(opening, closing, self.expression)
        return Node(kind, text, first.start, self.reader.last.end, first.line, items)

    def bracketed(self, opening: str, closing: str, read: Callable[[], Node]) -> tuple[Node, ...]:
        """Read what is in brackets, separated by commas, or nothing."""
        self.reader.expect(opening)
        if self.reader.accept(closing):
            return ()
        items = self.reader.separated(read)
        self.reader.expect(",", closing)
        return tuple(items)
