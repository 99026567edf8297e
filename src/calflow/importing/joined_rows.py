"""Joined rows: joints and points of foreign tables side by side, with recordings reduced to one row per standstill."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, refuse, truncated
from calflow.files.words import plural
from calflow.importing.column_role import DEVIATIONS, PLANNED, Roles, preferred, roles, seconds
from calflow.importing.foreign_table import ForeignColumn, ForeignTable, name_words
from calflow.importing.joint_mapping import FACTORS, LARGEST_TURN, SCALES
from calflow.importing.standstill import Standstill, find_standstills, is_recording
from calflow.robot.robot import Robot

FEWEST_POSES = 6  # least number of poses that identify a joint mapping
NEITHER = DEVIATIONS | PLANNED  # words in names of columns that are neither joints nor points
ONLY = ("only",)  # the group of the only three numeric columns of a table without names
WIDEST = 60  # columns among which unnamed joints and points are searched


@dataclass(frozen=True)
class Joined:
    """Rows of a table, or of two side by side: their columns, the indices of these by role, and notes on how they were read.

    path is that of the first file; named says whether the files name the columns.
    """

    path: Path
    title: str
    columns: tuple[ForeignColumn, ...]
    roles: Roles
    named: bool
    notes: tuple[str, ...] = ()

    @property
    def figures(self) -> np.ndarray:
        """The values of all columns, (n_rows, n_columns)."""
        return np.column_stack([column.figures for column in self.columns])

    def __len__(self) -> int:
        return len(self.columns[0].figures)

    @property
    def time(self) -> np.ndarray:
        """The time of each row (n_rows,) [s]; empty if there is no clock."""
        return np.empty(0) if self.roles.time is None else seconds(self.columns[self.roles.time])

    @property
    def free(self) -> list[int]:
        """The numeric columns without a role that may be joints or points: no row counters, constants or clocks."""
        roles = self.roles
        members: tuple[Mapping[Any, int], ...] = (*roles.joints.values(), *roles.points.values(), *roles.turns.values())
        taken = {
            roles.time,
            roles.temperature,
            *roles.labels.values(),
            *(k for member in members for k in member.values()),
        }
        return [
            k
            for k, column in enumerate(self.columns[:WIDEST])
            if k not in taken and column.is_figures and not (NEITHER & {*name_words(column.name)})
            and not (np.diff(column.figures) == 1).all() and np.nanstd(column.figures) > 0
        ]  # fmt: skip

    def has_joints(self, n: int) -> bool:
        """Return whether there are columns of n joints, or as many that may be."""
        groups = self.roles.joints.values()
        return any(len(members) >= n for members in groups) if groups else len(self.free) >= n

    def has_points(self, beside: int = 0) -> bool:
        """Return whether there are columns of a point, or of what may be one beside so many others."""
        return bool(self.roles.points) if self.named else len(self.free) >= beside + 3

    def rows(self, chosen: np.ndarray) -> Joined:
        """Return a subset of the rows, given by indices or by a mask."""
        columns = tuple(
            replace(column, cells=column.cells.iloc[chosen].reset_index(drop=True), figures=column.figures[chosen])
            for column in self.columns
        )
        return replace(self, columns=columns)

    def still(self, robot: Robot) -> Joined:
        """Return the standstills if the rows are a recording, else the rows unchanged.

        Raises:
            InputError: there are too few standstills to identify a joint mapping.
        """
        if not is_recording(self.time):
            return self
        stood = self.standstills(robot)
        note = f"a recording of {len(self)} rows: the rows are its {plural(len(stood), 'standstill')}"
        return replace(self.settled(stood), notes=(*self.notes, note))

    def standstills(self, robot: Robot) -> list[Standstill]:
        """Return the standstills of recorded joints.

        Raises:
            InputError: there are too few to identify a joint mapping.
        """
        stood = find_standstills(self.time, _rough_readings(self, robot))
        if len(stood) < FEWEST_POSES:
            raise refuse(
                f"{self.title}: a recording in which the robot stands still {len(stood)} times: expected at least {FEWEST_POSES}, "
                "each for half a second"
            )
        return stood

    def settled(self, stood: Sequence[Standstill]) -> Joined:
        """Return a row per standstill: the median of numbers and the mode of texts in its settled interval."""
        meanwhile = [standstill.counts(self.time) for standstill in stood]
        settled = (_settled_figures if column.is_figures else _settled_text for column in self.columns)
        columns = tuple(of(column, meanwhile) for of, column in zip(settled, self.columns, strict=True))
        return replace(self, columns=columns)


def joined_rows(
    tables: Sequence[ForeignTable], robot: Robot, stated: Mapping[str, str], problems: list[Problem]
) -> Iterator[Joined]:
    """Yield the candidates for joined rows: tables that contain both, then pairs of one of joints and one of points.

    stated maps calflow's column names to those that the user states; problems collects why tables cannot be joined.
    """
    n = len(robot.driven)
    each = [
        Joined(table.path, table.title, table.columns, _with_stated(table, roles(table, robot), stated), table.named, table.reasons)
        for table in tables
    ]  # fmt: skip
    yield from (rows for rows in each if rows.has_joints(n) and rows.has_points(n))

    def apart_in(joints: Joined, points: Joined) -> bool:
        return joints.has_joints(n) and points.has_points()

    ordered = ((a, b) if apart_in(a, b) else (b, a) for a, b in combinations(each, 2))
    apart = [pair for pair in ordered if apart_in(*pair)]
    for joints, points in apart:
        try:
            yield _side_by_side(joints, points, robot)
        except InputError as error:
            problems += error.problems
    if not apart and not problems:
        problems += [_untold(rows, table.part, n) for rows, table in zip(each, tables, strict=True)]


def _untold(rows: Joined, part: str, n: int) -> Problem:
    """The problem of a table that has not both n columns of joints and a point: what cannot be told, and how to name it."""
    titles = ", ".join(f"'{truncated(column.title)}'" for column in rows.columns[:12])
    joints, points = rows.has_joints(n), rows.has_points(n)
    what = [f"{plural(n, 'column')} of joints"] * (not joints) + ["x, y and z of a measured point"] * (not points)
    options = ["--column q1_deg=NAME"] * (points or not joints)
    options += ["--column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"] * (joints or not points)
    return Problem(
        f"{f'{part}: ' if part else ''}cannot tell {' or '.join(what) or 'what it holds'} among its columns {titles}; "
        f"name them: {' '.join(options)} …", rows.path,
    )  # fmt: skip


def _with_stated(table: ForeignTable, roles: Roles, stated: Mapping[str, str]) -> Roles:
    """The roles, with those that the user states in place of those by name."""
    by_name = {column.name: k for k, column in enumerate(table.columns)} | {
        column.title: k for k, column in enumerate(table.columns)
    }
    where = {ours: by_name[theirs.lstrip("-")] for ours, theirs in stated.items() if theirs.lstrip("-") in by_name}
    joints = {int(ours[1:].split("_")[0]) - 1: k for ours, k in where.items() if ours[0] == "q" and ours[1].isdigit()}
    points = {ours[0]: k for ours, k in where.items() if ours[:2] in ("x_", "y_", "z_")}
    return replace(
        roles,
        joints={("stated",): joints} if joints else roles.joints,
        points={("stated",): points} if len(points) == 3 else roles.points,
        time=next((k for ours, k in where.items() if ours.startswith("time_")), roles.time),
        labels={**roles.labels, **{ours: k for ours, k in where.items() if ours in ("pose", "marker", "payload")}},
    )


def _side_by_side(joints: Joined, points: Joined, robot: Robot) -> Joined:
    """The rows of two tables matched by the names of poses, by time, or, if equally many, by their order.

    Raises:
        InputError: the rows cannot be matched.
    """
    by_pose = _by_pose(joints, points)
    if by_pose is not None:
        mine, theirs = by_pose
        name = joints.columns[joints.roles.labels["pose"]].name
        note = f"rows of {joints.title} and {points.title} belong together by '{name}'"
        alone = ((joints, len(joints) - len(set(mine))), (points, len(points) - len(theirs)))
        note += "".join(f"; {plural(n, 'row')} of {rows.title} without a partner left out" for rows, n in alone if n)
        return _paired(joints.rows(mine), points.rows(theirs), note)
    if is_recording(joints.time):
        return _by_time(joints, points, robot)
    if len(joints) != len(points):
        raise refuse(
            f"{joints.title} has {plural(len(joints), 'row')} of joints and {points.title} {len(points)} of points, and "
            "nothing that both have says which belong together: expected a column of pose numbers in both, as many rows, or a "
            "recording with times",
            joints.path,
        )
    note = f"rows of {joints.title} and {points.title} belong together in their order: there are {len(joints)} of each"
    return _paired(joints, points, note)


def _rough_readings(rows: Joined, robot: Robot) -> np.ndarray:
    """Approximate joint readings (n_rows, n) [rad], accurate enough to detect motion."""
    groups = preferred(list(rows.roles.joints))
    chosen = list(rows.roles.joints[groups[0]].values()) if groups else _steadiest(rows, len(robot.driven))
    figures = rows.figures[:, chosen]
    unit = rows.columns[chosen[0]].unit
    factor = FACTORS.get(unit, np.pi / 180 if np.nanmax(np.abs(figures)) > LARGEST_TURN else 1.0)
    return np.asarray(figures * factor)


def _steadiest(rows: Joined, n: int) -> list[int]:
    """The n unnamed columns (by index) with the least change from row to row relative to their range.

    These are positions rather than speeds or noise.
    """

    def restless(k: int) -> float:
        figures = rows.columns[k].figures
        return float(np.nanmedian(np.abs(np.diff(figures))) / np.ptp(figures))

    return sorted(rows.free, key=restless)[:n]


def _by_pose(joints: Joined, points: Joined) -> tuple[np.ndarray, np.ndarray] | None:
    """The indices of the rows of two tables that name the same pose, unique in the first; None if too few do."""
    if not all("pose" in rows.roles.labels for rows in (joints, points)):
        return None
    names = [_labels(rows.columns[rows.roles.labels["pose"]]) for rows in (joints, points)]
    first = {name: k for k, name in enumerate(names[0])}
    if len(first) < len(names[0]):
        return None
    pairs = [(first[name], k) for k, name in enumerate(names[1]) if name in first]
    if len(pairs) < 0.5 * len(names[1]):
        return None
    mine, theirs = np.array(pairs).T
    return mine, theirs


def _labels(column: ForeignColumn) -> list[str]:
    """Comparable names of poses: numbers as such, texts by their digits if unambiguous, else in lower case."""
    if column.is_figures:
        return [f"{figure:g}" for figure in column.figures]
    texts = [str(cell).strip().lower() for cell in column.cells]
    ends = ["".join(sign for sign in text if sign.isdigit()).lstrip("0") for text in texts]
    return ends if all(ends) and len(set(ends)) == len(set(texts)) else texts


def _paired(joints: Joined, points: Joined, note: str) -> Joined:
    n, mine, theirs = len(joints.columns), joints.roles, points.roles

    def moved(members: Mapping[str, int]) -> dict[str, int]:
        return {name: k + n for name, k in members.items()}

    both = replace(
        mine,
        points={group: moved(members) for group, members in (theirs.points or _plain_points(points)).items()},
        turns={group: moved(members) for group, members in theirs.turns.items()},
        labels={**moved(theirs.labels), **mine.labels},
        time=mine.time if mine.time is not None else None if theirs.time is None else theirs.time + n,
        temperature=theirs.temperature + n if theirs.temperature is not None else mine.temperature,
    )
    notes = (*(f"{rows.title}: {told}" for rows in (joints, points) for told in rows.notes), note)
    title, columns = f"{joints.title} and {points.title}", (*joints.columns, *points.columns)
    return Joined(joints.path, title, columns, both, joints.named, notes)


def _plain_points(rows: Joined) -> dict[tuple[str, ...], dict[str, int]]:
    """The point of a table without names that has exactly three candidate columns."""
    free = rows.free
    return {ONLY: dict(zip("xyz", free, strict=True))} if len(free) == 3 else {}


def _by_time(joints: Joined, points: Joined, robot: Robot) -> Joined:
    """The standstills of recorded joints with the points measured then, matched in order if the clocks differ."""
    stood = joints.standstills(robot)
    at_rest, clock = joints.settled(stood), points.time
    named = next(iter(points.roles.points.values()), None)
    if len(clock) > 1 and _same_clock(joints.time, clock):
        then = points.settled(stood)
        seen = np.isfinite(then.columns[named["x"]].figures) if named else np.full(len(stood), True)
        # As many points, some of them of no standstill: the clocks are seconds apart.
        if seen.all() or len(stood) != len(points):
            note = (
                f"{len(stood)} standstills in {joints.title}, at {int(seen.sum())} of which {points.title} has points"
            )
            return _paired(at_rest.rows(seen), then.rows(seen), note)
    elif is_recording(clock):
        places = list(named.values()) if named else points.free
        scale = SCALES.get(points.columns[places[0]].unit, 1e-3)
        points = points.settled(find_standstills(clock, points.figures[:, places] * scale))
    if len(stood) != len(points):
        raise refuse(
            f"the robot stands still {plural(len(stood), 'time')} in {joints.title}, and {points.title} has "
            f"{plural(len(points), 'point')} on another clock: which belong together cannot be told; expected as many, or one "
            "clock",
            joints.path,
        )
    note = f"{len(stood)} standstills in {joints.title} and as many points in {points.title} belong together in their order"
    return _paired(at_rest, points, note)


def _same_clock(mine: np.ndarray, theirs: np.ndarray) -> bool:
    """Whether two time columns overlap by more than half of the shorter one."""
    common = min(mine.max(), theirs.max()) - max(mine.min(), theirs.min())
    return bool(common > 0.5 * min(np.ptp(mine), np.ptp(theirs)))


def _settled_figures(column: ForeignColumn, meanwhile: Sequence[np.ndarray]) -> ForeignColumn:
    figures = np.array([
        np.nanmedian(figures_then) if np.isfinite(figures_then := column.figures[rows]).any() else np.nan for rows in meanwhile
    ])  # fmt: skip
    return replace(column, figures=figures, cells=pd.Series([f"{v:.12g}" for v in figures], dtype=object))


def _settled_text(column: ForeignColumn, meanwhile: Sequence[np.ndarray]) -> ForeignColumn:
    cells = [next(iter(column.cells[rows].mode()), "") for rows in meanwhile]
    return replace(column, figures=np.full(len(cells), np.nan), cells=pd.Series(cells, dtype=object))
