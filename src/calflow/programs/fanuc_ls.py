"""FANUC LS: teach pendant programs of FANUC robots in text form, with positions in the section /POS.

Listings of system variables (.va) hold the controller's tools and frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calflow.deployment.conventions import NOTATIONS, NOWHERE
from calflow.files.problems import Problem
from calflow.programs.syntax import Grammar, Node, TreeBuilder, branch, leaves, lines_in, refusal
from calflow.programs.target import External, FanucConfiguration, Flag, Number, Program, Skipped, Target, Use

SUFFIXES = (".ls", ".va")
TABLE = re.compile(r"\[\*SYSTEM\*\]\$MNU(TOOL|FRAME)\b(?!NUM)([^\[]*\[.*?)(?=^[ \t]*\[\*|\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"\[\s*1\s*,\s*(\d+)\s*\]\s*=(.*?)(?=\[|\Z)", re.DOTALL)  # of the first motion group
COORDINATE = re.compile(r"\b([XYZWPR]):\s*(-?(?:\d+\.?\d*|\.\d+))")
BOM = "\xef\xbb\xbf"  # byte order mark of UTF-8
SECTIONS = ("/PROG", "/ATTR", "/APPL", "/MN", "/POS", "/END")  # in this order, those in the middle not in every file
PARTS = re.compile(r"[^\s=]+")
CONFIG = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
COMPONENTS = ("X", "Y", "Z", "W", "P", "R")
REMOTE = tuple(f"R{name}" for name in COMPONENTS)  # coordinates of a stationary (remote) tool
NOTATION = NOTATIONS["fanuc"]
UNITS = {"mm": 1e-3, "deg": np.pi / 180}
INSTRUCTION = re.compile(r"\s*(?:\d*\s*:|-* *;)")  # start of a line of /MN
MOTION = re.compile(r"\s*\d*\s*:\s*[JLCAS]\s*PR?\[|\s*:\s*PR?\[")  # a circular motion continues in the next line
POINT = re.compile(r"\bP\[\s*(\d+)\s*(?::[^\]]*)?\]")


class _Builder(TreeBuilder):
    """The coordinates of positions."""

    def whole(self, children: Sequence[Any]) -> Node:
        """A coordinate that is one token, as X = 1 mm."""
        return branch("coordinate", "", children[0], children[0], leaves(children[0], PARTS))


POSITIONS = Grammar("fanuc_ls", builder=_Builder())


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
    sections = _sections(text)
    relative, lines, skipped = _moves(sections["/MN"]) if "/MN" in sections else ({}, {}, [])
    targets = []
    if "/POS" in sections:
        part = sections["/POS"]
        # Blanks in place of the text before preserve byte positions and line numbers.
        tree = POSITIONS.tree(re.sub(r"[^\r\n]", " ", text[: part.start]) + part.text)
        stated = {int(position.items[0].text) for position in tree.items if position.items[0].text.isdigit()}
        skipped += [
            Skipped(f"P[{number}]", lines[number][0], "never taught", "has no position in /POS")
            for number in lines.keys() - stated
        ]
        for position in _positions(tree):
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


@dataclass(frozen=True)
class _Section:
    """The text of a section after its head, with its byte position and line."""

    text: str
    start: int
    line: int


def _sections(text: str) -> dict[str, _Section]:
    """Return the sections of a program by name."""
    heads = [
        (match.group(1), match.start(), match.end())
        for match in re.finditer(rf"(?:(?<![^\r\n])|(?<={BOM}))(/[A-Za-z]+)\b", text)
    ]
    if not heads or heads[0][0] != "/PROG" or text[: heads[0][1]].removeprefix(BOM).strip():
        raise refusal("expected /PROG at the beginning", 1)
    sections: dict[str, _Section] = {}
    place = -1
    for k, (name, begins, start) in enumerate(heads):
        line = 1 + lines_in(text[:begins])
        if name not in SECTIONS:
            raise refusal(f"unknown section {name}", line)
        if SECTIONS.index(name) < place or (name in sections and name != "/APPL"):
            raise refusal(f"section {name} stands after {heads[k - 1][0]}", line)
        place = SECTIONS.index(name)
        end = heads[k + 1][1] if k + 1 < len(heads) else len(text)
        sections[name] = _Section(text[start:end], start, line)
    if lacking := [name for name in ("/MN", "/POS", "/END") if name not in sections]:
        raise refusal(f"expected a section {lacking[0]}, found the end of the file", 1 + lines_in(text))
    return sections


def _moves(section: _Section) -> tuple[dict[int, int], dict[int, list[int]], list[Skipped]]:
    """Return from /MN the points used as increments (INC), with the line, the lines of moves to each point, and the
    moves that cannot be corrected."""
    relative: dict[int, int] = {}
    lines: dict[int, list[int]] = {}
    skipped = []
    for k, line in enumerate(re.split(r"\r\n|\r|\n", section.text)):
        number = section.line + k
        if k and line.strip() and not INSTRUCTION.match(line):
            raise refusal(f"expected an instruction, found {line.strip()[:20]!r}", number)
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


def _positions(tree: Node) -> Iterator[Target | Skipped]:
    """Yield the positions, P[1]{ groups };, by their first motion group."""
    names: set[str] = set()
    for position in tree.items:
        number, _, *groups = position.items
        name = f"P[{number.text}]"
        if not number.text.isdigit():
            raise refusal(f"expected the position's number, found '{number.text}'", number.line)
        if name in names:
            raise refusal(f"{name} is defined twice", position.line)
        names.add(name)
        given = [group.items[0].text for group in groups]
        for k, (title, group) in enumerate(zip(given, groups, strict=True)):
            if re.fullmatch(r"GP\d", title) is None or title in given[:k]:
                raise refusal(f"expected a group, as GP{k + 1}, found '{title}'", group.line)
            read_group = _group(group, name, position.line)
            if title == "GP1":
                yield read_group


def _group(group: Node, name: str, line: int) -> Target | Skipped:
    """GP1: UF : 0, UT : 1, CONFIG : '...', X = 1 mm, ... or J1 = 1 deg, ..."""
    _, frame, tool, quoted, *coordinates = group.items
    for what, index in (("UF", frame), ("UT", tool)):
        if not index.text.isdigit() and index.text != "F":  # F: the frame or tool in force
            raise refusal(f"expected the number of {what}, found '{index.text}'", index.line)
    configuration = _configuration(name, quoted) if quoted else None
    given = _coordinates(name, coordinates, configuration is not None)
    pose = {key: number for key, number in given.items() if key[0] != "E"}
    remote = next(iter(pose), "") in REMOTE
    joints = [f"J{k}" for k in range(1, len(pose) + 1)]
    wanted = joints if configuration is None else list(REMOTE if remote else COMPONENTS)
    if [*pose] != wanted:
        expected, found = ", ".join(wanted), ", ".join(pose)
        raise refusal(f"{name}: expected {expected} in this order, found {found}", coordinates[-1].line)
    if configuration and tuple(number.scale for number in pose.values()) != NOTATION.scales:
        raise refusal(f"{name}: expected X, Y and Z in mm and W, P and R in deg", coordinates[-1].line)
    if any(number.text.startswith("*") for number in pose.values()):
        return Skipped(name, line, "never taught", "was never taught")
    if remote:
        return Skipped(name, line, "standing tool", "is of a stationary tool")
    external = {
        int(key[1:]): External(number.written, "mm" if number.scale == UNITS["mm"] else "deg")
        for key, number in given.items()
        if key not in pose and not number.text.startswith("*")
    }
    turn = NOTATION.turn if configuration else None
    return Target(name, line, tuple(pose.values()), turn, configuration, (Use(tool.text, frame.text),), external)


def _coordinates(name: str, nodes: Sequence[Node], cartesian: bool) -> dict[str, Number]:
    """Return the coordinates of a position by name, among them those of external axes, E1, …"""
    own, expected = (r"R?[XYZWPR]", ", ".join(COMPONENTS)) if cartesian else (r"J[1-9]", "J1, J2, …")
    given: dict[str, Number] = {}
    for component, value, unit in (node.items for node in nodes):
        if re.fullmatch(rf"{own}|E[1-9]", component.text) is None:
            raise refusal(f"{name}: expected {expected} or E1, …, found '{component.text}'", component.line)
        if component.text in given:
            raise refusal(f"{name}: {component.text} is given twice", component.line)
        given[component.text] = Number(value.start, value.end, value.text, UNITS[unit.text])
    return given


def _configuration(name: str, token: Node) -> FanucConfiguration:
    """'N U T, 0, 0, 0'"""
    match = CONFIG.fullmatch(token.text)
    if match is None:
        raise refusal(f"{name}: expected a configuration such as 'N U T, 0, 0, 0', found {token.text}", token.line)
    spans = [(token.start + match.start(k), token.start + match.end(k), match.group(k)) for k in range(1, 7)]
    return FanucConfiguration(tuple(Flag(start, end, text) for start, end, text in spans))
