"""What is wrong with a user's input, collected and shown at once; with a look at a path before it is opened."""

from __future__ import annotations

import difflib
import re
import stat
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")

MOST_TOLD = 20  # problems of one kind that are told one by one; the others are counted
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")  # what no text has; tabs and ends of lines it has
MOST_COMPARED = 1000  # names that a wrong one is compared with
LONGEST_WORD, LONGEST_MESSAGE = 60, 1000  # characters of a user's own word, and of a whole message, that are shown
FILE_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


@dataclass(frozen=True)
class Problem:
    """One thing wrong with an input, where it stands and what was expected."""

    message: str
    file: Path | None = None
    line: int | None = None
    key: str | None = None

    def __str__(self) -> str:
        place = shortened(str(self.file), LONGEST_MESSAGE) if self.file else ""
        if self.line:
            place += f":{self.line}"
        key = shortened(self.key or "", LONGEST_MESSAGE)
        return seen(": ".join(part for part in (place, key, shortened(self.message, LONGEST_MESSAGE)) if part))


class InputError(Exception):
    """Input that calflow refuses; carries every problem found, never only the first."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class NoSuchFile(InputError):
    """A file that is not there."""


def refuse(message: str, file: Path | None = None, line: int | None = None, key: str | None = None) -> InputError:
    """Return the error for a single problem, to be raised by the caller."""
    return InputError([Problem(message, file, line, key)])


def refuse_any(problems: Iterable[Problem]) -> None:
    """Refuse an input where there is anything wrong with it.

    Raises:
        InputError: with all problems, where there are any.
    """
    if listed := tuple(problems):
        raise InputError(listed)


def together(*checks: Callable[[], Any]) -> list[Any]:
    """Call every check and return what they return.

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


def counted(
    items: Sequence[Item], tell: Callable[[Item], Problem], kind_of: Callable[[Item], str] = lambda _: ""
) -> list[Problem]:
    """Return a problem an item for the first of each kind, in order, and one that counts the others."""
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


def shortened(text: str, most: int = LONGEST_WORD) -> str:
    """Return a text that a message can show, cut where it is long."""
    return text if len(text) <= most else f"{text[:most]} …"


def seen(text: str) -> str:
    """Return a text whose signs all can be seen: those that a terminal hides, or obeys, are spelled as Python spells them."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def nearest(word: str, names: Iterable[str]) -> str:
    """Return `, did you mean 'x'?` for the name nearest to a wrong word (the first of many), or an empty string."""
    if len(word) > LONGEST_WORD:  # no name is so long, and the comparison would take its time
        return ""
    spelled = {name.lower(): name for name in islice(names, MOST_COMPARED)}
    close = difflib.get_close_matches(word.lower(), spelled, n=1, cutoff=0.5)
    return f", did you mean '{spelled[close[0]]}'?" if close else ""


def unknown_name(what: str, name: str, names: Collection[str]) -> str:
    """Say that a robot file has no marker, or payload, of a name; empty where it has, or none is named."""
    if not name or name in names:
        return ""
    there = f"there are {', '.join(names)}" if names else "the robot file has none: leave it out"
    return f"unknown {what} '{name}'; {there}{nearest(name, names)}"


def regular_file(path: Path, absent: str = "no such file") -> Path:
    """Return a path after a look at what is there, which opens nothing.

    Raises:
        NoSuchFile: nothing is there, with what to say of that.
        InputError: what is there is no regular file.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise NoSuchFile([Problem(absent, path)]) from None
    except (OSError, ValueError) as error:  # a name that is too long, or has a zero in it
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}", path) from None
    if not stat.S_ISREG(mode):
        raise refuse(
            f"cannot be read: not a regular file but {FILE_KINDS.get(stat.S_IFMT(mode), 'something else')}", path
        )
    return path
