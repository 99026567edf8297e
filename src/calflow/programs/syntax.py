"""Syntax: parsing a program into a tree of nodes with byte positions, by the grammar of its language.

Each language has a Lark grammar in a file of its name; the common rules for expressions are in `expressions.lark`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from calflow.files.problems import InputError, refuse, truncated
from calflow.programs.target import Number

if TYPE_CHECKING:
    from lark import Lark, UnexpectedInput

LONGEST_SHOWN = 20  # characters of a program's own text that a message shows
MOST_EXPECTED = 6  # tokens that a message names
DEEPEST = 60  # nesting depth of brackets, below Python's limit of recursion
NUMBER = re.compile(r"[-+.\dEe]+")
MEANINGS = {"NAME": "a name", "NUMBER": "a number", "STRING": "a text", "_NL": "the end of the line", "$END": "the end of the file",
            "_TEXT": "a line", "INSTRUCTION": "an instruction", "INDEX": "a whole number", "GROUP": "a group, as GP1"}  # fmt: skip
LEAVES = ("number", "string", "computed")  # values of one token, the last of them not evaluated
OPERATORS = {"OPERATOR", "SIGN", "LESS", "MORE", "COLON", "DOT"}


class Node(NamedTuple):
    """A syntax node: the grammar rule (kind), its text, bytes [start, end), line, child items and nesting depth.

    A number may carry a sign; a name includes its indices and components; a call's text is the function's name, its
    items the arguments; a keyword's item is its value; an operation's text holds its operators, separated by blanks,
    none for brackets. Other rules have a `token` for each word, and None for optional parts left out.
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
        """The positional arguments."""
        return tuple(item for item in self.items if item.kind != "keyword")

    def number(self, scale: float) -> Number:
        """Return the number that it is, with its factor to SI."""
        hexadecimal = self.text[1:2].lower() in ("x", "b", "o")  # or of another base
        return Number(self.start, self.end, str(int(self.text, 0)) if hexadecimal else self.text, scale)

    def keyword(self, name: str) -> Node | None:
        """Return the value of a keyword argument (name in lower case), if given."""
        keywords = (item for item in self.items if item.kind == "keyword" and item.text.lower() == name)
        return next((item.items[0] for item in keywords if item.items), None)

    def same(self, other: Node) -> bool:
        """Return whether another node has the same content, regardless of its position."""
        alike = (self.kind, self.text, len(self.items)) == (other.kind, other.text, len(other.items))
        return alike and all(item.same(another) for item, another in zip(self.items, other.items, strict=True))

    def walk(self) -> Iterator[Node]:
        """Yield this node and all its descendants."""
        yield self
        for item in self.items:
            yield from item.walk()


def leaf(token: Any, kind: str = "token") -> Node:
    """Return the node of a token."""
    return Node(kind, str(token), token.start_pos, token.end_pos, token.line)


def leaves(token: Any, pattern: re.Pattern[str], kind: str = "token") -> list[Node]:
    """Return a node for each match of a pattern in a token; lists of numbers are single tokens for speed."""
    start, line = token.start_pos, token.line
    return [
        Node(kind, match[0], start + match.start(), start + match.end(), line + token.count("\n", 0, match.start()))
        for match in pattern.finditer(token)
    ]


def branch(kind: str, text: str, first: Any, last: Any, items: Sequence[Any]) -> Node:
    """Return the node of child items, spanning from a first to a last token or node.

    Raises:
        InputError: nodes are nested too deeply.
    """
    depth = 1 + max((item.depth for item in items if item is not None), default=0)
    if depth > DEEPEST:
        raise refuse(f"more than {DEEPEST} nested brackets", line=first.line)
    start = first.start if isinstance(first, Node) else first.start_pos
    end = last.end if isinstance(last, Node) else last.end_pos
    return Node(kind, text, start, end, first.line, tuple(items), depth)


class TreeBuilder:
    """The transformer of parse rules to nodes: a method for each rule of expressions, and `rule` for all others."""

    brackets = ("[", "]")  # of indices

    def rule(self, rule: str, children: list[Any]) -> Any:
        """Return the node of any other rule."""
        # A rule with an underscore is inlined: its children go to the parent.
        if rule.startswith("_"):
            return SimpleNamespace(children=children)
        if rule in LEAVES:
            return leaf(children[0], str(rule))
        items = [child if child is None or isinstance(child, Node) else leaf(child) for child in children]
        present = [item for item in items if item is not None]
        if not present:
            return Node(str(rule), "", 0, 0, 0, tuple(items))
        return branch(str(rule), "", present[0], present[-1], items)

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
    """A grammar, from files beside this one, compiled at first use."""

    def __init__(self, *names: str, builder: TreeBuilder, **options: Any) -> None:
        self.names, self.builder, self.options = names, builder, options

    def tree(self, text: str) -> Node:
        """Return the syntax tree of a program (one character per byte).

        Raises:
            InputError: syntax error, with the line.
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
        """Return the message for a syntax error: what was expected and what was found."""
        from lark import UnexpectedToken

        if not isinstance(error, UnexpectedToken):
            return refuse(f"unexpected character {text[error.pos_in_stream or 0]!r}", line=error.line)
        token, names = error.token, set(error.accepts or error.expected)
        line = len(re.findall(r"\r\n|\r|\n", text)) + 1 if token.type == "$END" else token.line
        found = (
            MEANINGS[token.type] if token.type in ("$END", "_NL") else f"'{truncated(token.split()[0], LONGEST_SHOWN)}'"
        )
        if len(names) > MOST_EXPECTED:
            ends = {name for name in names if name.startswith("END") or name == "UNTIL"}
            names = ends or names - OPERATORS
        expected = " or ".join(sorted(map(self._meaning, names))[:MOST_EXPECTED])
        return refuse(f"expected {expected}, found {found}", line=line)

    def _meaning(self, name: str) -> str:
        """Return a terminal's name in messages."""
        pattern = None if name in MEANINGS else self._parser.get_terminal(name).pattern
        return MEANINGS[name] if pattern is None else f"'{pattern.value}'" if pattern.type == "str" else name.lower()
