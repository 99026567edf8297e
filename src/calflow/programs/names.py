"""Names: what the files of a project say of names, and what a name means where it is used, in this file or another."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from calflow.programs.syntax import Node

SHARED = ""  # the owner of names that all files of a project see
ALIAS = ""  # the component by which a type that is another name of one is kept


class Call(NamedTuple):
    """A call: in which routine it stands, which it calls, and what it gives."""

    caller: str
    routine: str
    arguments: Sequence[Node]


@dataclass
class Declared:
    """What a file says of names: with which type they are declared, which values they are given, which no other file sees.

    Files of one group see all of each other's names. The type of a component is kept by its type's name and its own, as
    `station.place`. A name of which something is changed in part is given a value that is computed.
    """

    group: str
    types: dict[str, str] = field(default_factory=dict)
    values: dict[str, list[Node]] = field(default_factory=lambda: defaultdict(list))
    private: set[str] = field(default_factory=set)
    components: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    parameters: dict[str, list[str]] = field(default_factory=dict)  # of routines, those that each call gives
    setting: set[str] = field(default_factory=set)  # routines that set the tool or the frame in force
    calls: list[Call] = field(default_factory=list)


class Project:
    """The names of all files of a project: those that all share, and those that belong to a group alone."""

    def __init__(self, files: Iterable[Declared]) -> None:
        self.private: dict[str, set[str]] = defaultdict(set)
        self.types: dict[tuple[str, str], str] = {}
        self.values: dict[tuple[str, str], list[Node]] = defaultdict(list)
        self.components: dict[str, dict[str, str]] = {}
        files = tuple(files)
        for file in files:
            self.private[file.group] |= file.private
            self.components |= file.components
        self.several = len(self.private) > 1
        self.setting = set[str]().union(*(file.setting for file in files))
        calls = [call for file in files for call in file.calls]
        while more := {call.caller for call in calls if call.routine in self.setting} - self.setting:
            self.setting |= more
        for file in files:
            scope = Scope(self, file.group)
            self.types |= {(scope.owner(name), name): kind for name, kind in file.types.items()}
            for name, values in file.values.items():
                self.values[scope.owner(name), name] += values


@dataclass(frozen=True)
class Scope:
    """A project's names as the files of a group see them: their own, then those that all share."""

    project: Project
    group: str

    def owner(self, name: str) -> str:
        """Return whose a name is."""
        return self.group if root(name) in self.project.private[self.group] else SHARED

    def label(self, name: str) -> str:
        """Return what a name is called so that no two of a project are alike."""
        return f"{name} of {self.group}" if self.project.several and self.owner(name) != SHARED else name

    def type_of(self, name: str) -> str:
        """Return the type of a name, or of its component; empty where it is not known."""
        first, *parts = re.sub(r"[{\[][^}\]]*[}\]]", "", name).split(".")
        kind = self.resolved(self.project.types.get((self.owner(first), first), ""))
        for part in parts:
            kind = self.resolved(self.project.components.get(kind, {}).get(part, ""))
        return kind

    def resolved(self, kind: str) -> str:
        """Return the type that a type is another name of, or itself."""
        other = self.project.components.get(kind, {}).get(ALIAS)
        return kind if other in (None, kind) else self.resolved(other)

    def values(self, name: str) -> list[Node]:
        """Return all values that the project gives a name, first those of its own, then those of all places of its array."""
        owner, names = self.owner(name), dict.fromkeys((name, root(name)))
        return [value for each in names for value in self.project.values.get((owner, each), ())]

    def value(self, name: str) -> Node | None:
        """Return the value of a name, where all that the project gives it is the same."""
        given, every = self.project.values.get((self.owner(name), name), []), self.values(name)
        return given[0] if given and all(value is given[0] or value.same(given[0]) for value in every) else None


def root(name: str) -> str:
    """Return a name without indices and components."""
    return re.split(r"[{\[.]", name, maxsplit=1)[0]
