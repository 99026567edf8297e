"""Syntax: a program as a tree of nodes with their places, by the grammar of its language.

Each language has its grammar in a file of its name, in Lark's notation; what all have in common is in `expressions.lark`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from calflow.files.problems import InputError, Problem, shortened

if TYPE_CHECKING:
    from lark import Lark, UnexpectedInput

LONGEST_SHOWN = 20  # characters of a program's own text that a message shows
MOST_EXPECTED = 6  # tokens that a message names
DEEPEST = 60  # brackets within brackets: no program has more, and Python itself ends at a thousand
NUMBER = re.compile(r"[-+.\dEe]+")
MEANINGS = {"NAME": "a name", "NUMBER": "a number", "STRING": "a text", "_NL": "the end of the line", "$END": "the end of the file",
            "QUOTED": "a configuration in quotes"}  # fmt: skip
OPERATORS = {"OPERATOR", "SIGN", "LESS", "MORE", "COLON", "DOT"}


class Node(NamedTuple):
    """What a rule of a grammar matches: the rule, its text, the bytes [start, end) where it stands, its line, what it is made of.

    A number may carry a sign; a name has its indices and components; a call's text is the function's name and its items the
    arguments; a keyword's item is its value; an operation's text are its operators with blanks between them, none of a value in
    brackets. Of other rules, a word is a `token`, and what is left out is None. depth counts what is within each other.
    """

    kind: str
    text: str
    start: int
    end: int
    line: int
    items: tuple[Any, ...] = ()
    depth: int = 0

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


def refusal(message: str, line: int) -> InputError:
    """Return the error that refuses a program at a line."""
    return InputError([Problem(message, line=line)])


def lines_in(text: str) -> int:
    """Return how many lines end in a text, whether with LF, CR or both."""
    return text.count("\n") + text.count("\r") - text.count("\r\n")


def leaf(token: Any, kind: str = "token") -> Node:
    """Return the node of a token."""
    return Node(kind, str(token), token.start_pos, token.end_pos, token.line)


def leaves(token: Any, pattern: re.Pattern[str], kind: str = "token") -> list[Node]:
    """Return the nodes of what a pattern finds in a token, which is one for speed: most of a program are figures."""
    start, line = token.start_pos, token.line
    return [
        Node(kind, match[0], start + match.start(), start + match.end(), line + token.count("\n", 0, match.start()))
        for match in pattern.finditer(token)
    ]


def branch(kind: str, text: str, first: Any, last: Any, items: Sequence[Any]) -> Node:
    """Return the node of others, from one token or node to another.

    Raises:
        InputError: too many are within each other.
    """
    depth = 1 + max((item.depth for item in items if item is not None), default=0)
    if depth > DEEPEST:
        raise refusal(f"more than {DEEPEST} brackets within each other", first.line)
    start = first.start if isinstance(first, Node) else first.start_pos
    end = last.end if isinstance(last, Node) else last.end_pos
    return Node(kind, text, start, end, first.line, tuple(items), depth)


class TreeBuilder:
    """What is made of the rules that expressions of all languages have; of any other, a node with all that it matches."""

    brackets = ("[", "]")  # of indices

    def rule(self, rule: str, children: list[Any]) -> Any:
        """Return the node of any other rule."""
        if rule.startswith("_"):  # a part of one, whose children are taken out again
            return SimpleNamespace(children=children)
        items = [child if child is None or isinstance(child, Node) else leaf(child) for child in children]
        there = [item for item in items if item is not None]
        return (
            branch(str(rule), "", there[0], there[-1], items) if there else Node(str(rule), "", 0, 0, 0, tuple(items))
        )

    def number(self, children: Sequence[Any]) -> Node:
        """A number."""
        return leaf(children[0], "number")

    def string(self, children: Sequence[Any]) -> Node:
        """A text."""
        return leaf(children[0], "string")

    def computed(self, children: Sequence[Any]) -> Node:
        """A value that is not looked into."""
        return leaf(children[0], "computed")

    def signed(self, children: Sequence[Any]) -> Node:
        """A value after a sign."""
        sign, value = children
        if value.kind == "number" and sign in ("+", "-") and value.text[0] not in "+-":
            return Node("number", sign + value.text, sign.start_pos, value.end, sign.line)
        return branch("operation", str(sign), sign, value, [value])

    def operation(self, children: Sequence[Any]) -> Node:
        """Values with operators between them."""
        return branch("operation", " ".join(children[1::2]), children[0], children[-1], children[::2])

    def inner(self, children: Sequence[Any]) -> Node:
        """A value in brackets."""
        return branch("operation", "", children[0], children[0], children)

    def list(self, children: Sequence[Any]) -> Node:
        """Values in brackets."""
        return branch("list", "", children[0], children[-1], [item for item in children[1:-1] if item is not None])

    def numbers(self, children: Sequence[Any]) -> Node:
        """Numbers alone in brackets."""
        return branch("list", "", children[0], children[0], leaves(children[0], NUMBER, "number"))

    def index(self, children: Sequence[Any]) -> Node:
        """Values in the brackets after a name."""
        return branch("index", "", children[0], children[-1], children[:-1])

    def name(self, children: Sequence[Any]) -> Node:
        """A name with its indices and components."""
        token, *parts = children
        text, (opening, closing) = str(token), self.brackets
        for part in parts:
            inner = [item.text for item in part.items]
            text += f"{opening}{','.join(inner)}{closing}" if part.kind == "index" else f".{inner[0]}"
        indices = [item for part in parts if part.kind == "index" for item in part.items]
        return branch("name", text, token, parts[-1], indices) if parts else leaf(token, "name")

    def call(self, children: Sequence[Any]) -> Node:
        """A function with its arguments."""
        name, arguments, end = children
        return branch("call", name.text, name, end, arguments.items if arguments else ())

    def keyword(self, children: Sequence[Any]) -> Node:
        """An argument with its name."""
        name, value = children
        return branch("keyword", str(name), name, value or name, [value] if value else [])


class Grammar:
    """A grammar, of files beside this one, which is compiled where it is first used."""

    def __init__(self, *names: str, builder: TreeBuilder, **options: Any) -> None:
        self.names, self.builder, self.options = names, builder, options

    def tree(self, text: str) -> Node:
        """Return a program (a character a byte) as a tree.

        Raises:
            InputError: it is not in the language, with the line.
        """
        from lark import UnexpectedInput

        try:
            node: Any = self._parser.parse(f"{text}\n".replace("\r\n", " \n").replace("\r", "\n"))
        except UnexpectedInput as error:
            raise self._refused(error, text) from None
        assert isinstance(node, Node)
        return node

    @cached_property
    def _parser(self) -> Lark:
        from lark import Lark

        grammar = "".join(Path(__file__).with_name(f"{name}.lark").read_text("utf-8") for name in self.names)
        builder: Any = self.builder
        return Lark(grammar, parser="lalr", transformer=builder, tree_class=builder.rule, **self.options)

    def _refused(self, error: UnexpectedInput, text: str) -> InputError:
        """What is wrong where the text does not go on as the grammar says."""
        from lark import UnexpectedToken

        if not isinstance(error, UnexpectedToken):
            return refusal(f"unexpected character {text[error.pos_in_stream or 0]!r}", error.line)
        token, names = error.token, set(error.accepts or error.expected)
        line = 1 + lines_in(text) if token.type == "$END" else token.line
        found = (
            MEANINGS[token.type] if token.type in ("$END", "_NL") else f"'{shortened(token.split()[0], LONGEST_SHOWN)}'"
        )
        if len(names) > MOST_EXPECTED:
            ends = {name for name in names if name.startswith("END") or name == "UNTIL"}
            names = ends or names - OPERATORS
        expected = " or ".join(sorted(map(self._meaning, names))[:MOST_EXPECTED])
        return refusal(f"expected {expected}, found {found}", line)

    def _meaning(self, name: str) -> str:
        """What a message calls a terminal."""
        pattern = None if name in MEANINGS else self._parser.get_terminal(name).pattern
        return MEANINGS[name] if pattern is None else f"'{pattern.value}'" if pattern.type == "str" else name.lower()
