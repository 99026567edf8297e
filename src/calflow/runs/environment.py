"""The environment: what is installed for calflow, and on what machine."""

from __future__ import annotations

import platform
import re
from functools import lru_cache
from importlib import metadata


def environment() -> dict[str, str]:
    """Return the version of every installed package that calflow needs, directly or through others, by its name."""
    return dict(_environment())


def machine() -> str:
    """Return the kind of machine, on which the last bits of numbers may depend."""
    return f"{platform.system()} {platform.machine()}"


def changes(was: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return in words which versions differ."""
    names = dict.fromkeys((*was, *now))
    return [
        f"{name} {was.get(name, 'not there')} → {now.get(name, 'not there')}"
        for name in names
        if was.get(name) != now.get(name)
    ]


@lru_cache
def _environment() -> tuple[tuple[str, str], ...]:
    found: dict[str, str] = {}
    waiting = ["calflow"]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            package = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # of another system, or an extra that is not installed
            continue
        found[name] = package.version
        waiting += [_name(need) for need in package.requires or () if "extra ==" not in need]
    return tuple(sorted(found.items()))


def _name(requirement: str) -> str:
    """The name of the package that a requirement is of, as registries write it."""
    word = re.match(r"[\w.-]+", requirement)
    return re.sub(r"[-_.]+", "-", word[0]).lower() if word else ""
