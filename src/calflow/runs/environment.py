"""The environment: what is installed for calflow, and on what machine."""

from __future__ import annotations

import platform
from functools import lru_cache
from importlib import metadata

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


def environment() -> dict[str, str]:
    """Return the version of every installed package that calflow needs, directly or through others, by its name."""
    return dict(_environment())


def machine() -> str:
    """Return the kind of machine, and which processor its linear algebra is for: the last bits of numbers depend on that."""
    import numpy as np  # noqa: F401  # its linear algebra must be there to be asked
    from threadpoolctl import threadpool_info

    kernels = sorted({library["architecture"] for library in threadpool_info() if "architecture" in library})
    return ", ".join([f"{platform.system()} {platform.machine()}", *(f"linear algebra for {name}" for name in kernels)])


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
        waiting += [canonicalize_name(need.name) for need in requirements(package)]
    return tuple(sorted(found.items()))


def requirements(package: metadata.Distribution, extra: str = "") -> list[Requirement]:
    """Return what a package needs on this machine; with the name of an extra, what it needs for that besides."""
    every = [Requirement(text) for text in package.requires or ()]
    plain = [need for need in every if need.marker is None or need.marker.evaluate({"extra": ""})]
    if not extra:
        return plain
    return [need for need in every if need not in plain and need.marker and need.marker.evaluate({"extra": extra})]
