"""FANUC LS: teach pendant programs of FANUC robots in text form, with positions in the section /POS.

Listings of system variables (.va) hold the controller's tools and frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOTATIONS, NOWHERE
from calflow.files.problems import Problem, refuse
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaves
from calflow.programs.target import External, FanucConfiguration, Flag, Program, Skipped, Target, Use

SUFFIXES = (".ls", ".va")
TABLE = re.compile(r"\[\*SYSTEM\*\]\$MNU(TOOL|FRAME)\b(?!NUM)([^\[]*\[.*?)(?=^[ \t]*\[\*|\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"\[\s*1\s*,\s*(\d+)\s*\]\s*=(.*?)(?=\[|\Z)", re.DOTALL)  # of the first motion group
COORDINATE = re.compile(r"\b([XYZWPR]):\s*(-?(?:\d+\.?\d*|\.\d+))")
BOM = "\xef\xbb\xbf"  # byte order mark of UTF-8
PARTS = re.compile(r"[^\s=]+")
COMPONENTS = ("X", "Y", "Z", "W", "P", "R")
REMOTE = tuple(f"R{name}" for name in COMPONENTS)  # coordinates of a stationary (remote) tool
EXTERNAL = tuple(f"E{k}" for k in range(1, 10))  # external axes
NOTATION = NOTATIONS["fanuc"]
UNITS = {"mm": 1e-3, "deg": np.pi / 180}
MOTION = re.compile(r"\s*\d*\s*:\s*[JLCAS]\s*PR?\[|\s*:\s*PR?\[")  # a circular motion continues in the next line
POINT = re.compile(r"\bP\[\s*(\d+)\s*(?::[^\]]*)?\]")


class _Builder(TreeBuilder):
    """The coordinates of positions."""

    def whole(self, children: Sequence[Any]) -> Node:
        """A coordinate that is one token, as X = 1 mm."""
        return branch("coordinate", "", children[0], children[0], leaves(children[0], PARTS))


GRAMMAR = Grammar("fanuc_ls", builder=_Builder())


def is_fanuc(text: str) -> bool:
    """Return whether a text begins like an LS program, or lists tools and frames."""
    return re.match(rf"(?:{BOM})?\s*/PROG\b", text) is not None or TABLE.search(text) is not None


def read_fanuc(source: bytes, file: str) -> Program:
    """Read a program, or a listing.

    Raises:
        InputError: it cannot be parsed, with the line.
    """
    text = source.decode("latin-1")
    if tables := TABLE.findall(text.replace("\r", "\n")):
        tools, frames = (
            {number: matrix for what, table in tables if what == kind for number, matrix in _entries(table)}
            for kind in ("TOOL", "FRAME")
        )
        return Program("fanuc", source, (), (), tools, frames, file)
    instructions, positions = GRAMMAR.tree(text).items
    relative, lines, skipped = _moves(instructions.items)
    targets = []
    stated = {int(position.items[0].text) for position in positions.items}
    skipped += [
        Skipped(f"P[{number}]", lines[number][0], "never taught", "has no position in /POS")
        for number in lines.keys() - stated
    ]
    for position in _positions(positions.items):
        number = int(re.findall(r"\d+", position.name)[0])
        if isinstance(position, Skipped):
            skipped.append(position)
        elif number in relative:
            reason = f"is an increment (INC) of the move in line {relative[number]}"
            skipped.append(Skipped(position.name, position.line, "relative", reason))
        else:
            (use,) = position.uses
            uses = tuple(replace(use, file=file, line=line) for line in lines.get(number, ()))
            targets.append(replace(position, uses=uses or (use,)))
    skipped.sort(key=lambda entry: entry.line)
    return Program("fanuc", source, tuple(targets), tuple(skipped), {"0": NOWHERE}, {"0": NOWHERE}, file)


def link_fanuc(files: Sequence[Program]) -> tuple[list[Program], list[Problem]]:
    """Return the programs of a project with the tools and frames on which its listings agree."""
    tools, frames = _agreed(file.tools for file in files), _agreed(file.frames for file in files)
    return [replace(file, tools=tools, frames=frames) for file in files], []


def _agreed(tables: Iterable[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the entries on which all tables agree."""
    entries: dict[str, list[np.ndarray]] = {}
    for table in tables:
        for number, matrix in table.items():
            entries.setdefault(number, []).append(matrix)
    return {number: every[0] for number, every in entries.items() if np.allclose(every[0], every)}


def _entries(table: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield number and pose of a table's entries, [1,2] = Group: 1 Config: … X: 1.000 …, except unset ones."""
    for number, entry in ENTRY.findall(table):
        given = {name: float(value) for name, value in COORDINATE.findall(entry)}
        if set(given) == set(COMPONENTS):
            yield number, NOTATION.pose([given[name] for name in COMPONENTS])


def _moves(instructions: Sequence[Node]) -> tuple[dict[int, int], dict[int, list[int]], list[Skipped]]:
    """Return from /MN the points used as increments (INC), with the line, the lines of moves to each point, and the
    moves that cannot be corrected."""
    relative: dict[int, int] = {}
    lines: dict[int, list[int]] = {}
    skipped = []
    for instruction in instructions:
        line, number = instruction.text, instruction.line
        if not MOTION.match(line):
            continue
        code = line.split("!", 1)[0]
        for point in POINT.findall(code):
            lines.setdefault(int(point), []).append(number)
        if re.search(r"\bINC\b", code):
            relative |= {int(point): number for point in POINT.findall(code)}
        elif "Offset" in code:
            what = f"move in line {number}"
            skipped.append(Skipped(what, number, "shared", "adds an offset to its point, whose correction it shares"))
        if re.match(r"[^%]*?\d?\s*:\s*[JLCAS]?\s*(?:P\[\s*R\[|PR\[)", code):
            skipped.append(Skipped(f"move in line {number}", number, "computed", "goes to a point given by a register"))
    return relative, lines, skipped


def _positions(positions: Sequence[Node]) -> Iterator[Target | Skipped]:
    """Yield the positions, P[1]{ groups };, by their first motion group."""
    names: set[str] = set()
    for position in positions:
        number, _, *groups = position.items
        name = f"P[{number.text}]"
        if name in names:
            raise refuse(f"{name} is defined twice", line=position.line)
        names.add(name)
        given = [group.items[0].text for group in groups]
        for k, (title, group) in enumerate(zip(given, groups, strict=True)):
            if title in given[:k]:
                raise refuse(f"expected a group, as GP{k + 1}, found '{title}'", line=group.line)
            read_group = _group(group, name, position.line)
            if title == "GP1":
                yield read_group


def _group(group: Node, name: str, line: int) -> Target | Skipped:
    """GP1: UF : 0, UT : 1, CONFIG : '...', X = 1 mm, ... or J1 = 1 deg, ..."""
    _, frame, tool, flags, *coordinates = group.items
    parts = [node.items for node in coordinates]
    given = {component.text: value.number(UNITS[unit.text]) for component, value, unit in parts}
    own = [node for node in coordinates if node.items[0].text not in EXTERNAL]
    names = [node.items[0].text for node in own]
    remote = names[:1] == ["RX"]
    wanted = [f"J{k}" for k in range(1, len(own) + 1)] if flags is None else REMOTE if remote else COMPONENTS
    odd = [node for node, found, expected in zip(own, names, wanted, strict=False) if found != expected]
    if odd or len(own) != len(wanted):
        message = f"{name}: expected {', '.join(wanted)} in this order, found {', '.join(names)}"
        raise refuse(message, line=(odd or coordinates[-1:])[0].line)
    if len(given) < len(coordinates):
        raise refuse(f"{name}: an external axis is given twice", line=coordinates[-1].line)
    numbers = tuple(given[component] for component in names)
    if flags and tuple(number.scale for number in numbers) != NOTATION.scales:
        raise refuse(f"{name}: expected X, Y and Z in mm and W, P and R in deg", line=coordinates[-1].line)
    if any(number.text.startswith("*") for number in numbers):
        return Skipped(name, line, "never taught", "was never taught")
    if remote:
        return Skipped(name, line, "standing tool", "is of a stationary tool")
    external = {
        int(key[1:]): External(number.written, "mm" if number.scale == UNITS["mm"] else "deg")
        for key, number in given.items()
        if key in EXTERNAL and not number.text.startswith("*")
    }
    uses, turn = (Use(tool.text, frame.text),), NOTATION.turn if flags else None
    configuration = (
        FanucConfiguration(tuple(Flag(flag.start, flag.end, flag.text) for flag in flags.items)) if flags else None
    )
    return Target(name, line, numbers, turn, configuration, uses, external)
