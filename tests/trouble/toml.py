"""What a TOML file says, read apart from calflow, and where what calflow holds of it differs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from typing import Any

from trouble.tables import FACTORS

FURTHER = FACTORS | {"kg": 1.0, "g": 1e-3, "rad_per_Nm": 1.0, "mm_per_m": 1e-3, "um_per_m": 1e-6, "m_per_m": 1.0}
Leaf = tuple[tuple[str, ...], Any]
EXACT = 1e-11  # relative, by which a number may differ from what was said
WORKED_OUT = "values"  # of a truth: they are not held, they stand in the rows that are made of them


def said(text: str) -> frozenset[Leaf]:
    """Return every value of a TOML text by its path, numbers in SI, keys without units; those that are 0 or nothing are left out.

    What is 0 or nothing says what holds where nothing is said.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n")  # the ends of lines of any system
    return frozenset(leaf for leaf in _leaves(tomllib.loads(lines), (), 1.0) if leaf[1] not in (0, "", False))


def numbers(held: Any) -> list[float]:
    """Return every number that is held anywhere in JSON's values."""
    if isinstance(held, dict):
        return [number for one in held.values() for number in numbers(one)]
    if isinstance(held, list | tuple):
        return [number for one in held for number in numbers(one)]
    return [float(held)] if isinstance(held, int | float) and not isinstance(held, bool) and abs(held) < 1e300 else []


def differences(before: str, after: str, held_before: Any, held_after: Any) -> Iterator[str]:
    """Say where what is held does not follow from what the text says: a change that does not show, a number that is not there."""
    old, new = said(before), said(after)
    if old == new:
        if held_before != held_after:
            yield "the same values are held as others"
        return
    if held_before == held_after and new - old:  # what is left out may be what holds where nothing is said
        yield f"a change does not show: {sorted(map(str, old ^ new))}"
    there = numbers(held_after)
    for path, value in new - old:
        if (
            path[0] != WORKED_OUT
            and isinstance(value, float)
            and not any(math.isclose(value, one, rel_tol=EXACT) for one in there)
        ):
            yield f"{'.'.join(path)} = {value!r} is not held"


def _leaves(value: Any, path: tuple[str, ...], factor: float) -> Iterator[Leaf]:
    if isinstance(value, dict):
        for key, own in value.items():
            name, unit = (
                (key, "") if isinstance(own, str) else _split(key)
            )  # a text has no factor: its key is all there is
            yield from _leaves(own, (*path, name), factor * FURTHER.get(unit, 1.0))
    elif isinstance(value, list):
        for k, own in enumerate(value):
            yield from _leaves(own, (*path, str(k)), factor)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(f"{factor * value:.12g}") if abs(value) < 1e300 else str(value)
    else:
        yield path, value if isinstance(value, str | bool) else str(value)


def _split(key: str) -> tuple[str, str]:
    unit = next((unit for unit in sorted(FURTHER, key=len, reverse=True) if key.endswith(f"_{unit}")), "")
    return (key.removesuffix(f"_{unit}"), unit) if unit else (key, "")
