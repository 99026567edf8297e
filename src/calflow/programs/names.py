"""Names: symbol tables of a project's files, and the scopes in which names are resolved."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from calflow.programs.syntax import Node

GLOBAL = ""  # the owner of global names
ALIAS = ""  # the component under which an alias type keeps the type it stands for


class Call(NamedTuple):
    """A call of a routine: the caller, the routine called, and the arguments."""

    caller: str
    routine: str
    arguments: Sequence[Node]


@dataclass
class SymbolTable:
    """A file's symbol table: types and assigned values of names, and which names are private to its group.

    Files of one group share their private names. The type of a component is kept by the names of its record type and
    itself. A name that is changed in part has a computed value.
    """

    group: str
    types: dict[str, str] = field(default_factory=dict)
    values: dict[str, list[Node]] = field(default_factory=lambda: defaultdict(list))
    private: set[str] = field(default_factory=set)
    components: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    parameters: dict[str, list[str]] = field(default_factory=dict)  # of each routine, those that every call passes
    frame_setters: set[str] = field(default_factory=set)  # routines that set the tool or the frame in force
    calls: list[Call] = field(default_factory=list)


class Project:
    """The symbol tables of a project: its global names, and those private to a group of files."""

    def __init__(self, files: Iterable[SymbolTable]) -> None:
        self.private: dict[str, set[str]] = defaultdict(set)
        self.types: dict[tuple[str, str], str] = {}
        self.values: dict[tuple[str, str], list[Node]] = defaultdict(list)
        self.components: dict[str, dict[str, str]] = {}
        files = tuple(files)
        for file in files:
            self.private[file.group] |= file.private
            self.components |= file.components
        self.several = len(self.private) > 1
        self.frame_setters = set[str]().union(*(file.frame_setters for file in files))
        calls = [call for file in files for call in file.calls]
        while more := {call.caller for call in calls if call.routine in self.frame_setters} - self.frame_setters:
            self.frame_setters |= more
        for file in files:
            scope = Scope(self, file.group)
            self.types |= {(scope.owner(name), name): kind for name, kind in file.types.items()}
            for name, values in file.values.items():
                self.values[scope.owner(name), name] += values


@dataclass(frozen=True)
class Scope:
    """A project's names as visible in the files of a group: private names first, then global ones."""

    project: Project
    group: str

    def owner(self, name: str) -> str:
        """Return the group that owns a name, or GLOBAL."""
        return self.group if root(name) in self.project.private[self.group] else GLOBAL

    def label(self, name: str) -> str:
        """Return a label of a name that is unique in the project."""
        return f"{name} of {self.group}" if self.project.several and self.owner(name) != GLOBAL else name

    def type_of(self, name: str) -> str:
        """Return the type of a name, or of its component; empty if unknown."""
        first, *parts = without_indices(name).split(".")
        kind = self.resolved(self.project.types.get((self.owner(first), first), ""))
        for part in parts:
            kind = self.resolved(self.project.components.get(kind, {}).get(part, ""))
        return kind

    def resolved(self, kind: str) -> str:
        """Return the type that an alias stands for, or the type itself."""
        other = self.project.components.get(kind, {}).get(ALIAS)
        return kind if other in (None, kind) else self.resolved(other)

    def values(self, name: str) -> list[Node]:
        """Return all values assigned to a name in the project, then those assigned to the whole of its array."""
        owner, names = self.owner(name), dict.fromkeys((name, root(name)))
        return [value for each in names for value in self.project.values.get((owner, each), ())]

    def value(self, name: str) -> Node | None:
        """Return the value of a name, if all its assignments in the project are the same; else None."""
        given, every = self.project.values.get((self.owner(name), name), []), self.values(name)
        return given[0] if given and all(value is given[0] or value.same(given[0]) for value in every) else None


def root(name: str) -> str:
    """Return a name without indices and components."""
    return re.split(r"[{\[.]", name, maxsplit=1)[0]


def without_indices(name: str) -> str:
    """Return a name without indices."""
    return re.sub(r"[{\[][^}\]]*[}\]]", "", name)
