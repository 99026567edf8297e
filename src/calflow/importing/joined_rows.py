"""Joined rows: joints and points of foreign tables side by side, with recordings reduced to one row per standstill."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
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
    """Rows that contain joints and points: columns of values (n_rows, n_columns), and their indices by role."""

    title: str
    columns: tuple[ForeignColumn, ...]
    roles: Roles
    notes: tuple[str, ...] = ()

    @property
    def figures(self) -> np.ndarray:
        """The values of all columns, (n_rows, n_columns)."""
        return np.column_stack([column.figures for column in self.columns])

    def __len__(self) -> int:
        return len(self.columns[0].figures)

    def still(self, robot: Robot) -> Joined:
        """Return the standstills if the rows are a recording, else the rows unchanged.

        Raises:
            InputError: there are too few standstills to identify a joint mapping.
        """
        if self.roles.time is None:
            return self
        time = seconds(self.columns[self.roles.time])
        if not is_recording(time):
            return self
        stood = _enough_standstills(self.title, time, _rough_readings(self.columns, self.roles, robot))
        note = f"a recording of {len(self)} rows: the rows are its {plural(len(stood), 'standstill')}"
        return replace(self, columns=_at_standstills(self.columns, time, stood), notes=(*self.notes, note))


def joined_rows(
    tables: Sequence[ForeignTable], robot: Robot, stated: Mapping[str, str], problems: list[Problem]
) -> Iterator[Joined]:
    """Yield the candidates for joined rows: tables that contain both, then pairs of one of joints and one of points.

    stated maps calflow's column names to those that the user states; problems collects why tables cannot be joined.
    """
    n = len(robot.driven)
    each = [(table, _with_stated(table, roles(table, robot), stated)) for table in tables]
    for table, own in each:
        if _has_joints(own, table, n) and _has_points(own, table, n):
            yield Joined(table.title, table.columns, own, table.reasons)

    def apart_in(joints: tuple[ForeignTable, Roles], points: tuple[ForeignTable, Roles]) -> bool:
        return _has_joints(joints[1], joints[0], n) and _has_points(points[1], points[0], 0)

    ordered = ((a, b) if apart_in(a, b) else (b, a) for a, b in combinations(each, 2))
    apart = [pair for pair in ordered if apart_in(*pair)]
    for joints, points in apart:
        try:
            yield _side_by_side(joints, points, robot)
        except InputError as error:
            problems += error.problems
    if not apart and not problems:
        problems += [_untold(table, own, n) for table, own in each]


def _untold(table: ForeignTable, own: Roles, n: int) -> Problem:
    """The problem of a table that has not both n columns of joints and a point: what cannot be told, and how to name it."""
    titles = ", ".join(f"'{truncated(column.title)}'" for column in table.columns[:12])
    joints, points = _has_joints(own, table, n), _has_points(own, table, n)
    what = [f"{plural(n, 'column')} of joints"] * (not joints) + ["x, y and z of a measured point"] * (not points)
    options = ["--column q1_deg=NAME"] * (points or not joints)
    options += ["--column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"] * (joints or not points)
    part = f"{table.part}: " if table.part else ""
    return Problem(
        f"{part}cannot tell {' or '.join(what) or 'what it holds'} among its columns {titles}; "
        f"name them: {' '.join(options)} …", table.path,
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


def _has_joints(roles: Roles, table: ForeignTable, n: int) -> bool:
    return any(len(members) >= n for members in roles.joints.values()) or (
        not roles.joints and len(without_role(roles, table.columns)) >= n
    )


def _has_points(roles: Roles, table: ForeignTable, beside: int) -> bool:
    if table.named:
        return bool(roles.points)
    return len(without_role(roles, table.columns)) >= beside + 3


def without_role(roles: Roles, columns: Sequence[ForeignColumn]) -> list[int]:
    """Return the numeric columns without a role that may be joints or points.

    Row counters, constant columns and clocks are excluded.
    """
    members: tuple[Mapping[Any, int], ...] = (*roles.joints.values(), *roles.points.values(), *roles.turns.values())
    taken = {roles.time, roles.temperature, *roles.labels.values(), *(k for member in members for k in member.values())}
    return [
        k
        for k, column in enumerate(columns[:WIDEST])
        if k not in taken and column.is_figures and not (NEITHER & {*name_words(column.name)})
        and not (np.diff(column.figures) == 1).all() and np.nanstd(column.figures) > 0
    ]  # fmt: skip


def _side_by_side(joints: tuple[ForeignTable, Roles], points: tuple[ForeignTable, Roles], robot: Robot) -> Joined:
    """The rows of two tables matched by the names of poses, by time, or, if equally many, by their order.

    Raises:
        InputError: the rows cannot be matched.
    """
    (first, of_joints), (other, of_points) = joints, points
    by_pose = _by_pose(first, of_joints, other, of_points)
    if by_pose is not None:
        mine, theirs = by_pose
        note = f"rows of {first.title} and {other.title} belong together by '{first.columns[of_joints.labels['pose']].name}'"
        alone = ((first, len(first) - len(set(mine))), (other, len(other) - len(theirs)))
        note += "".join(f"; {plural(n, 'row')} of {table.title} without a partner left out" for table, n in alone if n)
        return _paired(first.rows(mine), of_joints, other.rows(theirs), of_points, note)
    mine_at = seconds(first.columns[of_joints.time]) if of_joints.time is not None else None
    theirs_at = seconds(other.columns[of_points.time]) if of_points.time is not None else None
    if mine_at is not None and is_recording(mine_at):
        readings = _rough_readings(first.columns, of_joints, robot)
        return _by_time(first, of_joints, mine_at, readings, other, of_points, theirs_at)
    if len(first) != len(other):
        raise refuse(
            f"{first.title} has {plural(len(first), 'row')} of joints and {other.title} {len(other)} of points, and "
            "nothing that both have says which belong together: expected a column of pose numbers in both, as many rows, or a "
            "recording with times",
            first.path,
        )
    note = f"rows of {first.title} and {other.title} belong together in their order: there are {len(first)} of each"
    return _paired(first, of_joints, other, of_points, note)


def _rough_readings(columns: Sequence[ForeignColumn], roles: Roles, robot: Robot) -> np.ndarray:
    """Approximate joint readings (n_rows, n) [rad], accurate enough to detect motion."""
    group = preferred(list(roles.joints))[0] if roles.joints else None
    chosen = (
        list(roles.joints[group].values())
        if group is not None
        else _steadiest(columns, without_role(roles, columns), len(robot.driven))
    )
    figures = np.column_stack([columns[k].figures for k in chosen])
    unit = columns[chosen[0]].unit
    factor = FACTORS.get(unit, np.pi / 180 if np.nanmax(np.abs(figures)) > LARGEST_TURN else 1.0)
    return np.asarray(figures * factor)


def _steadiest(columns: Sequence[ForeignColumn], free: Sequence[int], n: int) -> list[int]:
    """The n unnamed columns (by index) with the least change from row to row relative to their range.

    These are positions rather than speeds or noise.
    """

    def restless(k: int) -> float:
        figures = columns[k].figures
        return float(np.nanmedian(np.abs(np.diff(figures))) / np.ptp(figures))

    return sorted(free, key=restless)[:n]


def _by_pose(
    one: ForeignTable, of_one: Roles, other: ForeignTable, of_other: Roles
) -> tuple[np.ndarray, np.ndarray] | None:
    """The indices of the rows of two tables that name the same pose, unique in the first; None if too few do."""
    if "pose" not in of_one.labels or "pose" not in of_other.labels:
        return None
    names = [_labels(table.columns[roles.labels["pose"]]) for table, roles in ((one, of_one), (other, of_other))]
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


def _paired(first: ForeignTable, of_one: Roles, other: ForeignTable, of_other: Roles, note: str) -> Joined:
    n = len(first.columns)

    def moved(members: Mapping[str, int]) -> dict[str, int]:
        return {name: k + n for name, k in members.items()}

    both = replace(
        of_one,
        points={group: moved(members) for group, members in of_other.points.items()}
        or _plain_points(of_other, other, n),
        turns={group: moved(members) for group, members in of_other.turns.items()},
        labels={**moved(of_other.labels), **of_one.labels},
        time=of_one.time if of_one.time is not None else None if of_other.time is None else of_other.time + n,
        temperature=of_other.temperature + n if of_other.temperature is not None else of_one.temperature,
    )
    reasons = (*(f"{first.title}: {r}" for r in first.reasons), *(f"{other.title}: {r}" for r in other.reasons), note)
    return Joined(f"{first.title} and {other.title}", (*first.columns, *other.columns), both, reasons)


def _plain_points(roles: Roles, table: ForeignTable, n: int) -> dict[tuple[str, ...], dict[str, int]]:
    """The point of a table without names that has exactly three candidate columns."""
    free = without_role(roles, table.columns)
    return {ONLY: {axis: k + n for axis, k in zip("xyz", free, strict=True)}} if len(free) == 3 else {}


def _by_time(
    first: ForeignTable, of_one: Roles, mine_at: np.ndarray, readings: np.ndarray, other: ForeignTable, of_other: Roles,
    theirs_at: np.ndarray | None,
) -> Joined:  # fmt: skip
    """The standstills of recorded joints with the points measured then, matched in order if the clocks differ."""
    stood = _enough_standstills(first.title, mine_at, readings)
    joints = replace(first, columns=_at_standstills(first.columns, mine_at, stood))
    if theirs_at is not None and len(theirs_at) > 1:
        if _same_clock(mine_at, theirs_at):
            points = replace(other, columns=_at_standstills(other.columns, theirs_at, stood))
            seen = np.full(len(stood), True)
            if of_other.points:
                seen = np.isfinite(points.columns[next(iter(of_other.points.values()))["x"]].figures)
            # As many points, some of them of no standstill: the clocks are seconds apart.
            if seen.all() or len(stood) != len(other):
                note = (
                    f"{len(stood)} standstills in {first.title}, at {int(seen.sum())} of which {other.title} has points"
                )
                return _paired(joints.rows(seen), of_one, points.rows(seen), of_other, note)
        elif is_recording(theirs_at):
            places = (
                next(iter(of_other.points.values())).values()
                if of_other.points
                else without_role(of_other, other.columns)
            )
            figures = np.column_stack([other.columns[k].figures for k in places])
            scale = SCALES.get(other.columns[next(iter(places))].unit, 1e-3)
            theirs = find_standstills(theirs_at, figures * scale)
            other = replace(other, columns=_at_standstills(other.columns, theirs_at, theirs))
    if len(stood) != len(other):
        raise refuse(
            f"the robot stands still {plural(len(stood), 'time')} in {first.title}, and {other.title} has "
            f"{plural(len(other), 'point')} on another clock: which belong together cannot be told; expected as many, or one clock",
            first.path,
        )
    note = (
        f"{len(stood)} standstills in {first.title} and as many points in {other.title} belong together in their order"
    )
    return _paired(joints, of_one, other, of_other, note)


def _enough_standstills(title: str, time: np.ndarray, readings: np.ndarray) -> list[Standstill]:
    """The standstills of a recording.

    Raises:
        InputError: there are too few to identify a joint mapping.
    """
    stood = find_standstills(time, readings)
    if len(stood) < FEWEST_POSES:
        raise refuse(
            f"{title}: a recording in which the robot stands still {len(stood)} times: expected at least {FEWEST_POSES}, each for "
            "half a second"
        )
    return stood


def _same_clock(mine: np.ndarray, theirs: np.ndarray) -> bool:
    """Whether two time columns overlap by more than half of the shorter one."""
    common = min(mine.max(), theirs.max()) - max(mine.min(), theirs.min())
    return bool(common > 0.5 * min(np.ptp(mine), np.ptp(theirs)))


def _at_standstills(
    columns: Sequence[ForeignColumn], time: np.ndarray, stood: Sequence[Standstill]
) -> tuple[ForeignColumn, ...]:
    """The columns with one row per standstill: the median of numbers and the mode of texts in its settled interval."""
    meanwhile = [standstill.counts(time) for standstill in stood]
    return tuple(
        _settled_figures(column, meanwhile) if column.is_figures else _settled_text(column, meanwhile)
        for column in columns
    )


def _settled_figures(column: ForeignColumn, meanwhile: Sequence[np.ndarray]) -> ForeignColumn:
    figures = np.array([
        np.nanmedian(figures_then) if np.isfinite(figures_then := column.figures[rows]).any() else np.nan for rows in meanwhile
    ])  # fmt: skip
    return replace(column, figures=figures, cells=pd.Series([f"{v:.12g}" for v in figures], dtype=object))


def _settled_text(column: ForeignColumn, meanwhile: Sequence[np.ndarray]) -> ForeignColumn:
    cells = [next(iter(column.cells[rows].mode()), "") for rows in meanwhile]
    return replace(column, figures=np.full(len(cells), np.nan), cells=pd.Series(cells, dtype=object))
