"""Plugins: effects and observations that other packages provide through entry points."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Collection
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import TypeVar

from calflow.files.problems import Problem, refuse_any

EFFECTS, OBSERVATIONS = "calflow.effects", "calflow.observations"  # groups of entry points: id = "module:Class"

Part = TypeVar("Part")
# All built-in errors that importing another package may raise, except those that end a program.
FAILS_TO_IMPORT = (
    ArithmeticError, AssertionError, AttributeError, BufferError, EOFError, ImportError, LookupError, MemoryError, NameError,
    OSError, ReferenceError, RuntimeError, SyntaxError, SystemError, TypeError, ValueError, Warning,
)  # fmt: skip


def catalogue_of(home: str, group: str, base: type[Part], flaw: Callable[[type[Part]], str]) -> dict[str, type[Part]]:
    """Return, by id, the classes of a calflow package (one per file) and those that other packages register.

    Args:
        home: dotted name of the package whose modules are imported.
        group: entry-point group; each entry point is named by the class's `id`.
        base: required base class.
        flaw: returns what else is wrong with a class of another package, or an empty string.

    Raises:
        InputError: naming every class of another package that cannot be used, with its package.
    """
    for module in iter_modules(import_module(home).__path__):
        import_module(f"{home}.{module.name}")
    here = [kind for kind in subclasses(base) if kind.__module__.startswith(f"{home}.")]
    kinds = {identifier: kind for kind in here if isinstance(identifier := getattr(kind, "id", None), str)}
    owner = dict.fromkeys(kinds, "calflow itself")
    problems = []
    for entry in sorted(entry_points(group=group), key=lambda entry: (entry.name, package(entry))):
        kind, wrong = _loaded(entry, base)
        if entry.name in owner:
            wrong = f"its id is taken by {owner[entry.name]}"
        if kind is not None and not wrong:
            wrong = flaw(kind)
        if kind is None or wrong:
            problems.append(
                Problem(f"package '{package(entry)}' brings '{entry.name}' to {group}, which cannot be used: {wrong}")
            )
        else:
            kinds[entry.name] = kind
            owner[entry.name] = f"package '{package(entry)}'"
    refuse_any(problems)
    return dict(sorted(kinds.items()))


def subclasses(of: type[Part]) -> list[type[Part]]:
    """Return all direct and indirect subclasses of a class, in order of definition."""
    return [kind for direct in of.__subclasses__() for kind in (direct, *subclasses(direct))]


@lru_cache
def packages() -> dict[str, str]:
    """Return the packages that provide plugins by name, each with its version and a hash of its code."""
    modules: dict[tuple[str, str], set[str]] = {}
    for group in (EFFECTS, OBSERVATIONS):
        for entry in entry_points(group=group):
            version = entry.dist.version if entry.dist else ""
            modules.setdefault((package(entry), version), set()).add(entry.module)
    return {name: f"{version} {_digest(module)}".strip() for (name, version), module in sorted(modules.items())}


def package(entry: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return entry.dist.name if entry.dist else entry.module.partition(".")[0]


def _loaded(entry: EntryPoint, base: type[Part]) -> tuple[type[Part] | None, str]:
    """The class that an entry point names, or None, with what is wrong with it."""
    try:
        kind = entry.load()
    except FAILS_TO_IMPORT as error:
        return None, f"{entry.value} cannot be imported ({type(error).__name__}: {error})"
    if not (inspect.isclass(kind) and issubclass(kind, base)):
        return None, f"{entry.value} is no subclass of {base.__module__}.{base.__qualname__}"
    if lacking := sorted(getattr(kind, "__abstractmethods__", ())):
        return None, f"{entry.value} lacks {', '.join(lacking)}"
    if (identifier := getattr(kind, "id", None)) != entry.name:
        return None, f"{entry.value} calls itself {identifier!r}; expected its id to be the entry point's name"
    return kind, ""


def _digest(modules: Collection[str]) -> str:
    """The hash of all files of the outermost packages that contain the modules."""
    digest = hashlib.sha256()
    for path in sorted({path for module in modules for path in _sources(module)}):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _sources(module: str) -> list[Path]:
    """The files of the outermost package that contains a module, or the module's own file; empty if it does not exist.

    Several distributions may share a namespace package, so the first regular package inside it counts.
    """
    names = module.split(".")
    for k in range(len(names)):
        try:
            spec = find_spec(".".join(names[: k + 1]))
        except ImportError:
            return []
        if spec is None:
            return []
        if spec.origin is None:
            continue
        if not spec.submodule_search_locations:
            return [Path(spec.origin)]
        return [
            path
            for folder in spec.submodule_search_locations
            for path in Path(folder).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        ]
    return []
