"""Problems in the user's input, collected to be reported at once, and the check of a path before it is opened."""

from __future__ import annotations

import difflib
import re
import stat
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")

MOST_TOLD = 20  # problems of one kind that are reported singly; the others are counted
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")  # control characters except tab and the ends of lines
MOST_COMPARED = 1000  # names with which a misspelt one is compared
LONGEST_WORD, LONGEST_MESSAGE = 60, 1000  # characters shown of a word of the user's, and of a whole message
FILE_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


@dataclass(frozen=True)
class Problem:
    """A problem in an input: its message, which says what was expected, and its file, line and key where known."""

    message: str
    file: Path | None = None
    line: int | None = None
    key: str | None = None

    def __str__(self) -> str:
        place = truncated(str(self.file), LONGEST_MESSAGE) if self.file else ""
        if self.line:
            place += f":{self.line}"
        key = truncated(self.key or "", LONGEST_MESSAGE)
        return escaped(": ".join(part for part in (place, key, truncated(self.message, LONGEST_MESSAGE)) if part))


class InputError(Exception):
    """The error for input that calflow refuses, with every problem found and not only the first."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class NoSuchFile(InputError):
    """The error for a file that does not exist."""


def refuse(message: str, file: Path | None = None, line: int | None = None, key: str | None = None) -> InputError:
    """Return the error for a single problem, to be raised by the caller."""
    return InputError([Problem(message, file, line, key)])


def refuse_any(problems: Iterable[Problem]) -> None:
    """Raise an error if there are any problems.

    Raises:
        InputError: with all problems, if there are any.
    """
    if listed := tuple(problems):
        raise InputError(listed)


def run_checks(*checks: Callable[[], Any]) -> list[Any]:
    """Call every check and return their results, in order.

    Raises:
        InputError: with the problems of all checks that failed.
    """
    results: list[Any] = []
    problems: list[Problem] = []
    for check in checks:
        try:
            results.append(check())
        except InputError as error:
            problems += error.problems
    refuse_any(problems)
    return results


def problems_of(*checks: Callable[[], Any]) -> tuple[Problem, ...]:
    """Return the problems of all checks that fail; none if none does."""
    try:
        run_checks(*checks)
    except InputError as error:
        return error.problems
    return ()


def limited_problems(
    items: Sequence[Item], tell: Callable[[Item], Problem], kind_of: Callable[[Item], str] = lambda _: ""
) -> list[Problem]:
    """Return one problem for each of the first items of a kind, in order, and one that counts the remaining items."""
    problems: list[Problem] = []
    totals, counts = Counter(map(kind_of, items)), Counter[str]()
    for item in items:
        kind = kind_of(item)
        counts[kind] += 1
        if counts[kind] <= MOST_TOLD:
            problems.append(tell(item))
        elif counts[kind] == MOST_TOLD + 1:
            more = f"and {totals[kind] - MOST_TOLD} more problems like this one"
            problems.append(replace(tell(item), message=more, key=None))
    return problems


def truncated(text: str, most: int = LONGEST_WORD) -> str:
    """Return a text truncated to the length that a message shows."""
    return text if len(text) <= most else f"{text[:most]} …"


def escaped(text: str) -> str:
    """Return a text with its unprintable characters, which a terminal hides or obeys, escaped as in Python."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def nearest(word: str, names: Iterable[str]) -> str:
    """Return `, did you mean 'x'?` with the name most similar to a misspelt word, or an empty string.

    A word that is a name's without some of its letters means that, of several the one that begins like it for longest:
    `temperature_C` is no temperature_K, `a_mrad` no theta_mrad.
    """
    if len(word) > LONGEST_WORD:  # no name is so long, and the comparison would be slow
        return ""
    spelled = {name.lower(): name for name in islice(names, MOST_COMPARED)}
    close = difflib.get_close_matches(word.lower(), spelled, cutoff=0.5)
    whole = [name for name in close if _is_shortened(word.lower(), name)]
    likeliest = max(whole, key=lambda name: _begins_alike(word.lower(), name)) if whole else next(iter(close), "")
    return f", did you mean '{spelled[likeliest]}'?" if likeliest else ""


def _is_shortened(word: str, name: str) -> bool:
    """Whether all letters of a word stand in a name, in their order."""
    left = iter(name)
    return all(letter in left for letter in word)


def _begins_alike(word: str, name: str) -> int:
    """Return with how many letters a word and a name both begin."""
    return sum(1 for _ in takewhile(lambda letters: letters[0] == letters[1], zip(word, name, strict=False)))


def nearest_file(path: Path) -> str:
    """Return `, did you mean 'x'?` with the file beside a path that is named most like it, or an empty string."""
    with suppress(OSError):
        beside = {file.stem.lower(): file.name for file in islice(sorted(path.parent.iterdir()), MOST_COMPARED)}
        if close := difflib.get_close_matches(path.stem.lower()[:LONGEST_WORD], beside, n=1):
            return f", did you mean '{beside[close[0]]}'?"
    return ""


def unknown_name(what: str, name: str, names: Collection[str]) -> str:
    """Return the message that the robot file has no marker or payload of a name; empty if it has or none is named."""
    if not name or name in names:
        return ""
    there = f"there are {', '.join(names)}" if names else "the robot file has none: leave it out"
    return f"unknown {what} '{name}'; {there}{nearest(name, names)}"


def regular_file(path: Path, absent: str = "no such file") -> Path:
    """Return a path after checking, without opening it, that it is a regular file.

    Raises:
        NoSuchFile: nothing is there; absent is the message.
        InputError: it cannot be inspected, or is not a regular file.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise NoSuchFile([Problem(f"{absent}{nearest_file(path)}", path)]) from None
    except (OSError, ValueError) as error:  # a name that is too long, or contains a null character
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}", path) from None
    if not stat.S_ISREG(mode):
        raise refuse(
            f"cannot be read: not a regular file but {FILE_KINDS.get(stat.S_IFMT(mode), 'something else')}", path
        )
    return path
