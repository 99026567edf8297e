"""Scanner: a program's text as tokens with their places, and a reader that goes through them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calflow.files.problems import InputError, Problem, shortened

SKIPPED = ("blank", "comment")
LONGEST_SHOWN = 20  # characters of a program's own text that a message shows


@dataclass(frozen=True)
class Token:
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
    found: list[Token] = []
    place, line = 0, 1
    while place < len(text):
        match = pattern.match(text, place)
        if match is None or match.end() == place:
            raise refusal(f"unexpected character {text[place]!r}", Token("", "", place, place, line))
        kind = match.lastgroup or ""
        if kind not in SKIPPED:
            found.append(Token(kind, match.group(), place, match.end(), line))
        line += lines_in(match.group())
        place = match.end()
    return [*found, Token("end", "", place, place, line)]


def lines_in(text: str) -> int:
    """Return how many lines end in a text, whether with LF, CR or both."""
    return text.count("\n") + text.count("\r") - text.count("\r\n")


class Reader:
    """A place in a sequence of tokens."""

    def __init__(self, tokens: Sequence[Token], fold: Callable[[str], str] = str) -> None:
        self._tokens, self._fold, self._at = tokens, fold, 0

    @property
    def next(self) -> Token:
        """The token to come; at the end it stays the last."""
        return self._tokens[min(self._at, len(self._tokens) - 1)]

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

    def take(self) -> Token:
        """Take the next token."""
        token = self.next
        self._at += 1
        return token

    def accept(self, *texts: str) -> Token | None:
        """Take the next token if it reads like one of these, other than as a text in quotes."""
        return self.take() if self.next.kind != "string" and self.word in texts else None

    def expect(self, *texts: str) -> Token:
        """Take the next token, which must read like one of these.

        Raises:
            InputError: it does not.
        """
        found = self.accept(*texts)
        if found is None:
            expected = " or ".join("the end of the line" if one in ("\n", "\r\n") else f"'{one}'" for one in texts[:6])
            raise refusal(f"expected {expected}, found {self.next}", self.next)
        return found

    def kind(self, kind: str, meaning: str) -> Token:
        """Take the next token, which must be of a kind.

        Raises:
            InputError: it is not.
        """
        if self.next.kind != kind:
            raise refusal(f"expected {meaning}, found {self.next}", self.next)
        return self.take()

    def blank(self) -> None:
        """Take empty lines."""
        while self.next.kind == "newline":
            self.take()

    def end_of_line(self) -> None:
        """Take the end of a statement that ends with its line, and empty lines."""
        if self.next.kind != "end":
            self.kind("newline", "the end of the line")
        self.blank()
