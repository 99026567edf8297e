"""Limits: what keys, texts and whole numbers of any TOML file may be, whatever they stand for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from calflow.files.problems import CONTROL

LONGEST_KEY, LONGEST_TEXT = 200, 10_000  # characters
LARGEST_WHOLE = 2**63 - 1  # of TOML
TOO_LONG = f"is too long: expected at most {LONGEST_KEY} characters in a name, {LONGEST_TEXT} in a text"

Found = Iterator[tuple[tuple[Any, ...], str]]


def beyond(raw: Any, where: tuple[Any, ...] = ()) -> Found:
    """Yield the places of what a parsed file holds beyond these limits, each with what to say."""
    if isinstance(raw, str):
        yield from _text(raw, LONGEST_TEXT, where)
    if isinstance(raw, int) and not -LARGEST_WHOLE <= raw <= LARGEST_WHOLE:
        yield where, f"expected a whole number of at most {LARGEST_WHOLE}"
    members = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    for key, value in members:
        unfit = list(_text(key, LONGEST_KEY, (*where, key))) if isinstance(key, str) else []
        yield from unfit or beyond(value, (*where, key))


def _text(text: str, longest: int, where: tuple[Any, ...]) -> Found:
    if len(text) > longest:
        yield where, TOO_LONG
    elif control := CONTROL.search(text):
        yield where, f"expected a text that can be seen, found the control character {control.group()!r}"
