"""Checks of measurements: what cannot be right is told with its line before any fit.

The header of a measurement file: which columns are read, and as what.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calflow.files.problems import MOST_TOLD, InputError, Problem, counted, nearest
from calflow.files.units import SUFFIXES
from calflow.measurements.columns import ANGLES, QUATERNION, SIGMAS, STEMS, WRENCH, column_names, numbered, split_column
from calflow.measurements.layout import Layout
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class ReadColumn:
    """A column that is read: calflow's name and unit for it, both as one word, the file's word, its marker ('': all)."""

    name: str
    unit: str
    ours: str
    theirs: str
    marker: str = ""

    def __str__(self) -> str:
        return f"column '{self.theirs}'" + (f" ({self.ours})" if self.ours != self.theirs else "")


def columns_read(there: Sequence[str], layout: Layout, robot: Robot, path: Path) -> list[ReadColumn]:
    """Return the columns that are read of those that are there: what the layout names, or else all.

    Raises:
        InputError: the layout names columns that are not there.
    """
    names = set(there)
    if absent := [name for name in dict.fromkeys(layout.named) if name not in names]:
        raise InputError(
            counted(
                absent,
                lambda name: Problem(
                    f"no column '{name}', which the study's mapping names{nearest(name, there)}", path, 1
                ),
            )
        )
    pairs = [("", ours, theirs) for ours, theirs in layout.columns.items()]
    pairs += [(marker, ours, theirs) for marker, own in layout.markers.items() for ours, theirs in own.items()]
    if not pairs:
        pairs = [("", name, name) for name in there]
    return [
        ReadColumn(*split_column(ours, robot, layout.reports), ours, theirs, marker) for marker, ours, theirs in pairs
    ]


MAX_ROWS_TOLD = 5  # a message names this many rows of a kind, then counts the rest
LEAST_SIGMA = 1e-15  # m or rad; below, what is divided by it is no number any more
MOVED = 0.02  # rad or m by which two readings of one pose may differ


def check_header(columns: Sequence[ReadColumn], layout: Layout, robot: Robot, conditions_only: bool) -> list[str]:
    """Say which columns are unknown, doubled, without their unit, or missing."""
    known = column_names(robot, layout.reports)
    first = {(column.name, column.marker): column for column in reversed(columns)}
    wrong = [
        column for column in columns
        if _doubled(column, first) or not _is_known(column, known) or (conditions_only and column.name in layout.reports.values)
    ]  # fmt: skip
    unknown = [_mistake(column, first, known) for column in wrong[:MOST_TOLD]]
    if len(wrong) > MOST_TOLD:
        unknown.append(f"and {len(wrong) - MOST_TOLD} more columns like these")
    missing: list[str] = []
    for marker in dict.fromkeys([column.marker for column in columns if column.marker] or [""]):
        own = {column.name: column for column in columns if column.marker in ("", marker)}
        missing += _missing(own, marker, layout, robot, conditions_only)
    names = {column.name: column for column in columns}
    oriented = not conditions_only and layout.reports.measured and bool({"rx", "qw"} & set(names))
    told = []
    for name, stated in (("sigma", layout.sigma), ("sigma_rotation", layout.sigma_rotation)):
        if stated is not None and name in names:
            told.append(f"{names[name]}: the study's [measurements] states {name} too; expected one of them")
    if oriented and robot.tool_rotation is None:
        told.append("has measured orientations, but the robot file does not say how the tool is turned: expected "
                    "tool_rotation_deg (or _rad) = [rx, ry, rz] there")  # fmt: skip
    if oriented and layout.sigma_rotation is None and "sigma_rotation" not in names:
        told.append("has measured orientations, but not how sure they are: expected a column sigma_rotation_mrad (or _rad, "
                    "_deg), or sigma_rotation_mrad = … in the study's [measurements]")  # fmt: skip
    if "rx" in names and "qw" in names:
        told.append("has orientations twice, as rx, ry, rz and as a quaternion: expected one of them")
    return list(dict.fromkeys((*unknown, *missing, *told)))


Columns = Mapping[tuple[str, str], ReadColumn]  # by name and marker


def _doubled(column: ReadColumn, first: Columns) -> bool:
    """Whether an earlier column, of all markers or of its own, has a column's name."""
    return first.get((column.name, ""), first[column.name, column.marker]) is not column


def _is_known(column: ReadColumn, known: Mapping[str, str]) -> bool:
    """Whether a column's name is one of calflow's, with a unit where it needs one."""
    dimension = known.get(column.name)
    return dimension is not None and column.unit in (SUFFIXES[dimension] if dimension else ("",))


def _mistake(column: ReadColumn, first: Columns, known: Mapping[str, str]) -> str:
    """Say what is wrong with a column's name."""
    name = column.name
    if _doubled(column, first):
        return f"{column}: '{name}' is there twice, in different units"
    if name not in known or (column.unit and not known[name]):
        every = [f"{n}_{s}" if s else n for n, d in known.items() for s in SUFFIXES.get(d, ("",))]
        return f"unknown {column}{nearest(column.ours, every)}"
    if not _is_known(column, known):
        wanted = ", ".join(f"{name}_{suffix}" for suffix in SUFFIXES[known[name]])
        return f"{column} needs a unit of {known[name]} in its name: {wanted}"
    return f"{column} is what will be predicted: leave it out of the rows"


def _missing(
    own: dict[str, ReadColumn], marker: str, layout: Layout, robot: Robot, conditions_only: bool
) -> list[str]:  # fmt: skip
    """Say which columns the rows of a marker ('' for all) lack."""
    n, known = robot.n_joints, column_names(robot, layout.reports)
    required = numbered("q", n) if layout.reports.measured else []
    required += [] if conditions_only else [*layout.reports.needed]
    if len(robot.markers) > 1 and not marker:
        required.append("marker")
    groups = [*(numbered(stem, n) for stem in STEMS.values()), WRENCH, ANGLES, QUATERNION]
    if not layout.reports.measured:  # external axes are stated where the arm's joints are asked for
        groups[0] = [f"q{joint + 1}" for joint in robot.arm]
    required += [name for group in groups if own.keys() & set(group) for name in group]
    following = {f"{stem}{joint + 1}" for joint in robot.followers for stem in STEMS.values()}
    where = ""
    if layout.columns or layout.markers:
        place = f"markers.{marker}" if marker else "columns"
        where = f" in the study's [measurements.{place}]"
    return [
        f"missing column: expected {' or '.join(f'{name}_{s}' if s else name for s in SUFFIXES.get(known[name], ('',)))}{where}"
        for name in dict.fromkeys(required)
        if name not in own and name not in following
    ]


def check_values(table: pd.DataFrame, robot: Robot, path: Path | None) -> list[Problem]:
    """Find names that the robot lacks, rows that contradict each other, and values out of range."""
    problems = [*_names(table, robot, path), *_figures(table, robot, path)]
    if "split" in table:
        split = table["split"].where(table["split"].isin(["train", "holdout"]))
        problems += at_rows(split.isna(), table, path, "split: expected 'train' or 'holdout'")
        mixed = split.groupby(table["pose"]).transform("nunique") > 1
        problems += at_rows(mixed, table, path, "split: one pose is in train and in holdout; held out is a whole pose")
    twice = table.duplicated(["pose", "repeat", "marker"], keep="first") & (table["pose"] != "")
    problems += at_rows(twice, table, path, "duplicate pose: the same pose, repeat and marker stand in an earlier row")
    joints = table[numbered("q", robot.n_joints)]
    moved = (joints - joints.groupby(table["pose"]).transform("first")).abs().max(axis=1) > MOVED
    problems += at_rows(
        moved & ~twice,
        table,
        path,
        "duplicate pose: this pose number has other joint readings in an earlier row",
    )
    return problems


def _names(table: pd.DataFrame, robot: Robot, path: Path | None) -> list[Problem]:
    problems: list[Problem] = []
    for name, known, optional in (("marker", robot.markers, False), ("payload", robot.payloads, True)):
        unknown = [value for value in table[name].unique() if value not in known and not (optional and value == "")]
        names = ", ".join(known) or "none"
        for value in unknown[:MOST_TOLD]:
            problems += at_rows(table[name] == value, table, path,
                                f"unknown {name} '{value}'; the robot file has {names}{nearest(value, known)}")  # fmt: skip
        if len(unknown) > MOST_TOLD:
            problems.append(Problem(f"and {len(unknown) - MOST_TOLD} more names of a {name} that is not there", path))
    return problems


def _figures(table: pd.DataFrame, robot: Robot, path: Path | None) -> list[Problem]:
    problems: list[Problem] = []
    for i in range(robot.n_joints):
        if f"approach{i + 1}" in table:
            wrong = ~table[f"approach{i + 1}"].isin([-1, 0, 1, np.nan])
            problems += at_rows(wrong, table, path, f"approach{i + 1}: expected -1, 0 or 1")
    for name in SIGMAS:
        if name in table:
            wrong = table[name] < LEAST_SIGMA
            problems += at_rows(wrong, table, path, f"{name}: expected a positive standard deviation")
    if "qw" in table:
        norm = np.linalg.norm(table[[*QUATERNION]], axis=1)
        problems += at_rows(np.abs(norm - 1) > 0.01, table, path, "qw, qx, qy, qz: expected a quaternion of norm 1")
    return problems


def at_rows(bad: Any, table: pd.DataFrame, path: Path | None, message: str) -> list[Problem]:
    """One problem a line for the first few bad rows, and one that counts the rest."""
    lines = list(dict.fromkeys(table["line"].to_numpy()[np.asarray(bad, dtype=bool)]))
    told = [
        Problem(message, path, int(line)) if path else Problem(message, key=f"row {line}")
        for line in lines[:MAX_ROWS_TOLD]
    ]
    if len(lines) > MAX_ROWS_TOLD:
        told.append(Problem(f"{message} (and {len(lines) - MAX_ROWS_TOLD} more rows)", path))
    return told
