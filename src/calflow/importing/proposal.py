"""A proposal: measurements made of foreign tables, where each column comes from and why, and in words what cannot be told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calflow.files.problems import InputError, Problem, nearest, refuse, refuse_any, shortened
from calflow.importing.bag import bag_tables, is_bag
from calflow.importing.column_role import ACTUAL, DEVIATIONS, PLANNED, Roles, name_words, preferred, roles, seconds
from calflow.importing.foreign_table import ForeignColumn, ForeignTable, foreign_tables
from calflow.importing.joint_mapping import (
    LEAST,
    SCALES,
    FlangeKinematics,
    JointMapping,
    JointReading,
    family,
    mapped,
    readings_of,
    unit_by_scale,
)
from calflow.importing.orientation import told_orientations
from calflow.importing.standstill import Standstill, find_standstills, is_recording, settled
from calflow.robot.robot import Robot

FEWEST_POSES = 6  # by which a mapping is told
CLOSE = 0.01  # of the points' spread that is left where the order of joints without names needs no further look
EXACT = 1e-5  # m: a nominal robot is so near only to points that were computed with it
ONE_POSE = 3e-4  # rad or m within which readings are of one pose
FACTORS = {"deg": np.pi / 180, "rad": 1.0, "mrad": 1e-3, "si": 1.0, "mm": 1e-3, "m": 1.0}
LARGEST_TURN = 2.2 * np.pi  # of readings in rad; more are degrees
SLIDE = 10.0  # of a slide's readings in m; more are mm
NEITHER = DEVIATIONS | PLANNED  # words of columns that without a role are neither joints nor points
ONLY = ("only",)  # the words of three columns of figures without names
MOST_WINDOWS = (60, 20, 4)  # places of joints without names at which signs, orders, and both are tried
WIDEST = 60  # columns of figures in which joints and points are looked for without names


@dataclass(frozen=True)
class ColumnOrigin:
    """Where a column of the measurements comes from, how it is changed, and why."""

    ours: str
    theirs: str
    how: str
    reason: str


@dataclass(frozen=True)
class ImportProposal:
    """Measurements as calflow writes them, where each column comes from, and what else is to be known."""

    table: pd.DataFrame
    origins: tuple[ColumnOrigin, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Choice:
    """Columns taken for a point's x, y and z in a unit, the words they share, and the joints with which the robot is there."""

    mapping: JointMapping
    points: tuple[int, ...]
    unit: str
    group: tuple[str, ...]


@dataclass(frozen=True)
class Joined:
    """Rows of joints and points side by side: figures (n_rows, n_columns) of columns, and the columns' numbers by their role."""

    title: str
    columns: tuple[ForeignColumn, ...]
    roles: Roles
    notes: tuple[str, ...] = ()

    @property
    def figures(self) -> np.ndarray:
        """Every column's figures, (n_rows, n_columns)."""
        return np.column_stack([one.figures for one in self.columns])

    def __len__(self) -> int:
        return len(self.columns[0].figures)


def propose_import(
    paths: Sequence[Path], robot: Robot, stated: Mapping[str, str] | None = None, sigma_rotation: float | None = None
) -> ImportProposal:
    """Return what measurements some files hold: the joints by the robot's forward kinematics, all else by names and figures.

    stated names columns of the files that are not to be guessed: calflow's name to theirs, with a minus before one that counts
    the other way. sigma_rotation [rad] is the standard deviation of measured orientations, which are left out without.

    Raises:
        InputError: what cannot be told, or a file that cannot be read.
    """
    tables = [table for path in paths for table in (bag_tables(path) if is_bag(path) else foreign_tables(path))]
    own = dict(stated or {})
    _check_stated(own, tables)
    tables = [_in_stated_units(table, own) for table in _appended(tables)]
    problems: list[Problem] = []
    for joined in _joined(tables, robot, own, problems):
        try:
            return _proposed(joined, robot, own, sigma_rotation)
        except InputError as error:
            problems += error.problems
    raise InputError(dict.fromkeys(problems))


def _appended(tables: Sequence[ForeignTable]) -> list[ForeignTable]:
    """Tables with the same names of columns are one, row after row."""
    found: list[ForeignTable] = []
    for table in tables:
        titles = [one.title for one in table.columns]
        same = [k for k, one in enumerate(found) if table.named and [c.title for c in one.columns] == titles]
        if not same:
            found.append(table)
            continue
        before = found[same[0]]
        columns = tuple(
            replace(a, cells=pd.concat([a.cells, b.cells], ignore_index=True), figures=np.r_[a.figures, b.figures])
            for a, b in zip(before.columns, table.columns, strict=True)
        )
        reasons = (*before.reasons, f"rows of {table.title} follow")
        found[same[0]] = replace(before, columns=columns, reasons=reasons)
    return found


def _joined(
    tables: Sequence[ForeignTable], robot: Robot, stated: Mapping[str, str], problems: list[Problem]
) -> Iterator[Joined]:
    """Each way in which tables may make rows of joints and points: one table alone, then one of joints beside one of points."""
    n = len(robot.driven)
    each = [(table, _with_stated(table, roles(table, robot), stated)) for table in tables]
    for table, own in each:
        if _has_joints(own, table, n) and _has_points(own, table, n):
            yield Joined(table.title, table.columns, own, table.reasons)
    apart = [
        (a, b) if _has_joints(a[1], a[0], n) and _has_points(b[1], b[0], 0) else (b, a)
        for a, b in combinations(each, 2)
        if (_has_joints(a[1], a[0], n) and _has_points(b[1], b[0], 0))
        or (_has_joints(b[1], b[0], n) and _has_points(a[1], a[0], 0))
    ]
    for joints, points in apart:
        try:
            yield _side_by_side(joints, points, robot)
        except InputError as error:
            problems += error.problems
    if not apart and not problems:
        for table, own in each:
            said = ", ".join(f"'{shortened(one.title)}'" for one in table.columns[:12])
            what = [
                *([] if _has_joints(own, table, n) else [f"{n} columns of joints"]),
                *([] if _has_points(own, table, n) else ["x, y and z of a measured point"]),
            ]
            problems.append(
                Problem(f"{table.title}: cannot tell {' or '.join(what) or 'what it holds'} among its columns {said}; "
                        "name them: --column q1_deg=NAME --column x_mm=NAME …", table.path)
            )  # fmt: skip


def _check_stated(stated: Mapping[str, str], tables: Sequence[ForeignTable]) -> None:
    """Refuse stated columns that no table has, and a point of which not all three are stated."""
    there = {name for table in tables for one in table.columns for name in (one.name, one.title)}
    refuse_any(
        Problem(f"no column '{theirs.lstrip('-')}'{nearest(theirs.lstrip('-'), there)}", key=f"--column {ours}")
        for ours, theirs in stated.items()
        if theirs.lstrip("-") not in there
    )
    if 0 < sum(ours.partition("_")[0] in ("x", "y", "z") for ours in stated) < 3:
        raise refuse("expected all of x, y and z, or none", key="--column")


def _in_stated_units(table: ForeignTable, stated: Mapping[str, str]) -> ForeignTable:
    """A table in which columns that say no unit have that by which they are stated."""
    units = {theirs.lstrip("-"): ours.partition("_")[2] for ours, theirs in stated.items()}
    columns = tuple(replace(one, unit=one.unit or units.get(one.name, "")) for one in table.columns)
    return replace(table, columns=columns)


def _with_stated(table: ForeignTable, own: Roles, stated: Mapping[str, str]) -> Roles:
    """Roles with what the user states in the place of what names say."""
    by_name = {one.name: k for k, one in enumerate(table.columns)} | {
        one.title: k for k, one in enumerate(table.columns)
    }
    where = {ours: by_name[theirs.lstrip("-")] for ours, theirs in stated.items() if theirs.lstrip("-") in by_name}
    joints = {int(ours[1:].split("_")[0]) - 1: k for ours, k in where.items() if ours[0] == "q" and ours[1].isdigit()}
    points = {ours[0]: k for ours, k in where.items() if ours[:2] in ("x_", "y_", "z_")}
    return replace(
        own,
        joints={("stated",): joints} if joints else own.joints,
        points={("stated",): points} if len(points) == 3 else own.points,
        time=next((k for ours, k in where.items() if ours.startswith("time_")), own.time),
        labels={**own.labels, **{ours: k for ours, k in where.items() if ours in ("pose", "marker", "payload")}},
    )


def _has_joints(own: Roles, table: ForeignTable, n: int) -> bool:
    return any(len(members) >= n for members in own.joints.values()) or (
        not own.joints and len(_unnamed(own, table)) >= n
    )


def _has_points(own: Roles, table: ForeignTable, beside: int) -> bool:
    if table.named:
        return bool(own.points)
    return len(_unnamed(own, table)) >= beside + 3


def _unnamed(own: Roles, table: ForeignTable) -> list[int]:
    """Columns of figures that may be joints or points where names do not say: what counts rows, stays, or is a clock is none."""
    members: tuple[Mapping[Any, int], ...] = (*own.joints.values(), *own.points.values(), *own.turns.values())
    taken = {own.time, own.temperature, *own.labels.values(), *(k for one in members for k in one.values())}
    return [
        k
        for k, one in enumerate(table.columns[:WIDEST])
        if k not in taken and one.is_figures and not (NEITHER & {*name_words(one.name)})
        and not _counts(one.figures) and np.nanstd(one.figures) > 0
    ]  # fmt: skip


def _counts(figures: np.ndarray) -> bool:
    return bool(np.isfinite(figures).all() and (np.diff(figures) == 1).all())


# Joints and points that stand in two tables.


def _side_by_side(joints: tuple[ForeignTable, Roles], points: tuple[ForeignTable, Roles], robot: Robot) -> Joined:
    """Rows of two tables that belong together: by the name of a pose, by time, or by their order where there are as many.

    Raises:
        InputError: nothing says which rows belong together.
    """
    (one, of_joints), (other, of_points) = joints, points
    by_pose = _by_pose(one, of_joints, other, of_points)
    if by_pose is not None:
        mine, theirs = by_pose
        note = (
            f"rows of {one.title} and {other.title} belong together by '{one.columns[of_joints.labels['pose']].name}'"
        )
        return _paired(one.rows(mine), of_joints, other.rows(theirs), of_points, note)
    mine_at = seconds(one.columns[of_joints.time]) if of_joints.time is not None else None
    theirs_at = seconds(other.columns[of_points.time]) if of_points.time is not None else None
    readings = _rough_readings(one, of_joints, robot)
    if mine_at is not None and is_recording(mine_at, readings):
        return _by_time(one, of_joints, mine_at, readings, other, of_points, theirs_at)
    if len(one) != len(other):
        raise refuse(
            f"{one.title} has {len(one)} rows of joints and {other.title} {len(other)} of points, and nothing that both have says "
            "which belong together: expected a column of pose numbers in both, as many rows, or a recording with times",
            one.path,
        )
    note = f"rows of {one.title} and {other.title} belong together in their order: there are {len(one)} of each"
    return _paired(one, of_joints, other, of_points, note)


def _rough_readings(table: ForeignTable, own: Roles, robot: Robot) -> np.ndarray:
    """The joints' readings (n_rows, n) in rad, as far as it matters for whether they move."""
    group = preferred(list(own.joints))[0] if own.joints else None
    chosen = (
        list(own.joints[group].values())
        if group is not None
        else _steadiest(table, _unnamed(own, table), len(robot.driven))
    )
    figures = np.column_stack([table.columns[k].figures for k in chosen])
    unit = table.columns[chosen[0]].unit
    factor = FACTORS.get(unit, np.pi / 180 if np.nanmax(np.abs(figures)) > LARGEST_TURN else 1.0)
    return np.asarray(figures * factor)


def _steadiest(table: ForeignTable, columns: Sequence[int], n: int) -> list[int]:
    """Of columns without names the n that change least from row to row for their range: positions, not their speeds or noise."""

    def restless(k: int) -> float:
        figures = table.columns[k].figures
        return float(np.nanmedian(np.abs(np.diff(figures))) / np.ptp(figures))

    return sorted(columns, key=restless)[:n]


def _by_pose(
    one: ForeignTable, of_one: Roles, other: ForeignTable, of_other: Roles
) -> tuple[np.ndarray, np.ndarray] | None:
    """Which rows of two tables name the same pose, one of the first for each of the second's; None where they do not."""
    if "pose" not in of_one.labels or "pose" not in of_other.labels:
        return None
    names = [_labels(table.columns[own.labels["pose"]]) for table, own in ((one, of_one), (other, of_other))]
    first = {name: k for k, name in enumerate(names[0])}
    if len(first) < len(names[0]):
        return None
    pairs = [(first[name], k) for k, name in enumerate(names[1]) if name in first]
    if len(pairs) < 0.5 * len(names[1]):
        return None
    mine, theirs = np.array(pairs).T
    return mine, theirs


def _labels(column: ForeignColumn) -> list[str]:
    """Names of poses: figures as whole numbers, texts in small letters, and what is a figure behind letters alone as that."""
    if column.is_figures:
        return [f"{figure:g}" for figure in column.figures]
    texts = [str(cell).strip().lower() for cell in column.cells]
    ends = ["".join(sign for sign in text if sign.isdigit()).lstrip("0") for text in texts]
    return ends if all(ends) and len(set(ends)) == len(set(texts)) else texts


def _paired(one: ForeignTable, of_one: Roles, other: ForeignTable, of_other: Roles, note: str) -> Joined:
    n = len(one.columns)

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
    reasons = (*(f"{one.title}: {r}" for r in one.reasons), *(f"{other.title}: {r}" for r in other.reasons), note)
    return Joined(f"{one.title} and {other.title}", (*one.columns, *other.columns), both, reasons)


def _plain_points(own: Roles, table: ForeignTable, n: int) -> dict[tuple[str, ...], dict[str, int]]:
    """The points of a table without names, where it has three columns that may be them."""
    free = _unnamed(own, table)
    return {ONLY: {axis: k + n for axis, k in zip("xyz", free, strict=True)}} if len(free) == 3 else {}


def _by_time(
    one: ForeignTable, of_one: Roles, mine_at: np.ndarray, readings: np.ndarray, other: ForeignTable, of_other: Roles,
    theirs_at: np.ndarray | None,
) -> Joined:  # fmt: skip
    """The standstills of a recording of joints, each with what was measured meanwhile; in order where the clocks differ."""
    stood = _enough_standstills(one.title, mine_at, readings)
    joints = _at_standstills(one, mine_at, stood)
    if theirs_at is not None and len(theirs_at) > 1:
        clock = _same_clock(mine_at, theirs_at)
        recorded = is_recording(theirs_at, readings)
        if clock:
            points = _at_standstills(other, theirs_at, stood)
            seen = (
                np.isfinite(points.columns[next(iter(of_other.points.values()))["x"]].figures)
                if of_other.points
                else None
            )
            seen = np.full(len(stood), True) if seen is None else seen
            note = f"{len(stood)} standstills in {one.title}, at {int(seen.sum())} of which {other.title} has points"
            return _paired(joints.rows(seen), of_one, points.rows(seen), of_other, note)
        if recorded:
            places = next(iter(of_other.points.values())).values() if of_other.points else _unnamed(of_other, other)
            figures = np.column_stack([other.columns[k].figures for k in places])
            scale = SCALES.get(other.columns[next(iter(places))].unit, 1e-3)
            theirs = find_standstills(theirs_at, figures * scale)
            other = _at_standstills(other, theirs_at, theirs)
    if len(stood) != len(other):
        raise refuse(
            f"the robot stands still {len(stood)} times in {one.title}, and {other.title} has {len(other)} points on another "
            "clock: which belong together cannot be told; expected as many, or one clock",
            one.path,
        )
    note = f"{len(stood)} standstills in {one.title} and as many points in {other.title} belong together in their order"
    return _paired(joints, of_one, other, of_other, note)


def _enough_standstills(title: str, time: np.ndarray, readings: np.ndarray) -> list[Standstill]:
    """The standstills of a recording.

    Raises:
        InputError: they are too few to tell anything by.
    """
    stood = find_standstills(time, readings)
    if len(stood) < FEWEST_POSES:
        raise refuse(
            f"{title}: a recording in which the robot stands still {len(stood)} times: expected at least {FEWEST_POSES}, each for "
            "half a second"
        )
    return stood


def _same_clock(mine: np.ndarray, theirs: np.ndarray) -> bool:
    """Whether two clocks run over the same time for the most part."""
    common = min(mine.max(), theirs.max()) - max(mine.min(), theirs.min())
    return bool(common > 0.5 * min(np.ptp(mine), np.ptp(theirs)))


def _at_standstills(table: ForeignTable, time: np.ndarray, stood: Sequence[Standstill]) -> ForeignTable:
    """A row a standstill: the median of every column's figures while it counts."""
    values = np.column_stack([one.figures for one in table.columns])
    rows = np.array([settled(time, values, one) for one in stood]).reshape(len(stood), values.shape[1])
    columns = tuple(
        replace(one, figures=rows[:, k], cells=pd.Series([f"{v:.12g}" for v in rows[:, k]], dtype=object))
        for k, one in enumerate(table.columns)
    )
    return replace(table, columns=columns)


# Joints and points side by side: which columns they are.


def _proposed(joined: Joined, robot: Robot, stated: Mapping[str, str], sigma_rotation: float | None) -> ImportProposal:
    """The measurements that rows of joints and points make.

    Raises:
        InputError: what cannot be told.
    """
    notes = list(joined.notes)
    joined = _still(joined, robot, notes)
    marker, markers = _marker(joined, robot)
    flange, here = FlangeKinematics.of(robot, marker), np.array(robot.markers[marker].point)
    figures = joined.figures
    first = np.full(len(joined), True) if markers is None else np.array([name == marker for name in markers])
    found: list[Choice] = []
    for width in range(3):
        windows = list(_joint_choices(joined, robot))
        for joints, named in windows:
            if width and (named or len(windows) > MOST_WINDOWS[width]):
                continue
            for points, group in _point_choices(joined, joints):
                rows = first & np.isfinite(figures[:, [*joints, *points]]).all(axis=1)
                if _distinct(figures[rows][:, joints]) < FEWEST_POSES:
                    continue
                for plain in _plain_hypotheses(joined, joints, robot, figures[rows], stated):
                    asked = [] if ("stated",) in joined.roles.joints else family(plain, width)
                    for unit in _units(joined, points, figures[rows], flange, plain):
                        measured = figures[rows][:, points] * SCALES[unit]
                        mapping = mapped(
                            flange, plain, asked, figures[rows], measured, here, robot.markers[marker].known
                        )
                        found.append(Choice(mapping, points, unit, group))
        if any(one.mapping.fits and (named or one.mapping.taken.error < CLOSE * one.mapping.spread) for one in found):
            break
    if not found:
        raise refuse(
            f"{joined.title}: fewer than {FEWEST_POSES} different poses with all joints and a point: too few to tell columns by"
        )
    best = _best(found, joined, notes)
    mapping = best.mapping
    if not mapping.fits:
        raise refuse(_misfit(mapping, joined, robot))
    if mapping.rivals and _other_readings(mapping, figures):
        raise refuse(
            f"{joined.title}: {1 + len(mapping.rivals)} ways to read the joints fit equally well ({_ways(mapping, joined)}): "
            "name them: --column q1_deg=NAME …, with a minus before NAME where the joint counts the other way"
        )
    return _made(joined, best, (marker, markers), flange, sigma_rotation, notes)


def _still(joined: Joined, robot: Robot, notes: list[str]) -> Joined:
    """Rows of a recording of both as its standstills."""
    if joined.roles.time is None:
        return joined
    time = seconds(joined.columns[joined.roles.time])
    table = ForeignTable(Path(joined.title), "", joined.columns, True)
    readings = _rough_readings(table, joined.roles, robot)
    if not is_recording(time, readings):
        return joined
    stood = _enough_standstills(joined.title, time, readings)
    notes.append(f"a recording of {len(joined)} rows: its {len(stood)} standstills are the rows")
    still = _at_standstills(table, time, stood)
    return replace(joined, columns=still.columns)


def _marker(joined: Joined, robot: Robot) -> tuple[str, list[str] | None]:
    """The marker by which the mapping is told, and the rows' own, by the robot's names.

    Raises:
        InputError: the robot has several, and no column says which is a row's.
    """
    names = {name.lower(): name for name in robot.markers}
    if "marker" in joined.roles.labels:
        own = [names.get(str(cell).lower(), str(cell)) for cell in joined.columns[joined.roles.labels["marker"]].cells]
        return max(set(own), key=own.count), own
    if len(names) > 1:
        raise refuse(
            f"{joined.title}: no column says which of the robot's markers ({', '.join(robot.markers)}) a row is of: expected one "
            "that holds these names, or a robot file with the marker that was measured alone"
        )
    return next(iter(robot.markers)), None


def _joint_choices(joined: Joined, robot: Robot) -> Iterator[tuple[tuple[int, ...], bool]]:
    """Columns that may be the driven joints, in order, and whether their names say which is which."""
    driven = robot.driven
    for group in preferred(list(joined.roles.joints)):
        members = joined.roles.joints[group]
        if all(i in members for i in driven):
            yield tuple(members[i] for i in driven), True
        elif len(members) == len(driven):
            yield tuple(members[i] for i in sorted(members)), True
    if joined.roles.joints:
        return
    table = ForeignTable(Path(joined.title), "", joined.columns, False)
    free = _unnamed(joined.roles, table)
    for start in range(len(free) - len(driven) + 1):
        yield tuple(free[start : start + len(driven)]), False


def _point_choices(joined: Joined, joints: Sequence[int]) -> Iterator[tuple[tuple[int, ...], tuple[str, ...]]]:
    """Columns that may be a measured point's x, y and z, and the words that they share."""
    for group in preferred(list(joined.roles.points)):
        members = joined.roles.points[group]
        yield (members["x"], members["y"], members["z"]), group
    if joined.roles.points:
        return
    table = ForeignTable(Path(joined.title), "", joined.columns, False)
    free = [k for k in _unnamed(joined.roles, table) if k not in joints]
    for one, two, three in zip(free, free[1:], free[2:], strict=False):
        if three == one + 2:
            yield (one, two, three), ()


def _distinct(figures: np.ndarray) -> int:
    return len(np.unique(np.round(figures, 3), axis=0))


def _plain_hypotheses(
    joined: Joined, joints: Sequence[int], robot: Robot, figures: np.ndarray, stated: Mapping[str, str]
) -> list[JointReading]:
    """The joints as their names have them: in the unit that they say, or in each that their figures allow."""
    signs = tuple(-1 if stated.get(f"q{i + 1}_{u}", "").startswith("-") else 1 for i, u in _stated_units(robot, stated))
    turning = np.array([robot.joints[i].kind == "revolute" for i in robot.driven])
    units = [joined.columns[k].unit for k in joints]
    largest = np.nanmax(np.abs(figures[:, joints]), axis=0)
    ways = []
    for turn in ("deg", "rad"):
        if turn == "rad" and turning.any() and (largest[turning] > LARGEST_TURN).any():
            continue
        own = [
            unit if unit in FACTORS else turn if turns else "mm" if most > SLIDE else "m"
            for unit, turns, most in zip(units, turning, largest, strict=True)
        ]
        ways.append(JointReading(tuple(joints), signs, tuple(FACTORS[unit] for unit in own)))
    return list(dict.fromkeys(ways))


def _stated_units(robot: Robot, stated: Mapping[str, str]) -> list[tuple[int, str]]:
    return [(i, next((s.split("_")[1] for s in stated if s.startswith(f"q{i + 1}_")), "")) for i in robot.driven]


def _units(
    joined: Joined, points: Sequence[int], figures: np.ndarray, flange: FlangeKinematics, plain: JointReading
) -> list[str]:
    """The units that a point's columns may be in: what they say, and what makes them as far apart as the robot's places."""
    said = joined.columns[points[0]].unit
    fitting = unit_by_scale(figures[:, points], flange, readings_of(plain, figures))
    return list(dict.fromkeys([said, fitting] if said in SCALES else [fitting]))


def _best(found: Sequence[Choice], joined: Joined, notes: list[str]) -> Choice:
    """The choice that fits best of those that were measured, by their names; what fits to rounding was computed.

    Raises:
        InputError: all was computed, or two different points fit and their names do not say which was measured.
    """
    fitting = [one for one in found if one.mapping.fits]
    computed = [one for one in fitting if one.mapping.taken.error < EXACT and one.group != ("stated",)]
    measured = [one for one in fitting if one not in computed and not PLANNED & {*one.group}]
    if fitting and not measured:
        raise refuse(
            f"{joined.title}: {_titles(fitting[0], joined)} are where the nominal robot is, or are called as what was planned. "
            "Where was it measured? Name the columns: --column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"
        )
    if computed:
        notes.append(
            f"{_titles(computed[0], joined)} are where the nominal robot is, to rounding: computed, and left out"
        )
    if not measured:
        return min(found, key=lambda one: one.mapping.taken.error / one.mapping.spread)
    apart = {one.points: one for one in reversed(measured)}
    named = [points for points, one in apart.items() if ACTUAL & {*one.group}]
    if len(apart) > 1 and len(named) != 1 and joined.roles.points:
        each = " and ".join(_titles(one, joined) for one in apart.values())
        raise refuse(
            f"{joined.title}: {each} fit the robot all, and their names do not say which was measured. Name the columns: "
            "--column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"
        )
    own = [one for one in measured if not named or one.points == named[0]]
    best = min(own, key=lambda one: one.mapping.taken.error / one.mapping.spread)
    # Of joints that are as good, what the names prefer, which comes first.
    good = max(2 * best.mapping.taken.error, best.mapping.taken.error + LEAST)
    return next(one for one in own if one is best or one.mapping.taken.error <= good)


def _titles(choice: Choice, joined: Joined) -> str:
    return ", ".join(f"'{joined.columns[k].title}'" for k in choice.points)


def _misfit(mapping: JointMapping, joined: Joined, robot: Robot) -> str:
    return (
        f"{joined.title}: no order, unit or sign of its joints puts robot '{robot.name}' where the points were measured: "
        f"at best they are {1e3 * mapping.taken.error:.0f} mm off (median), as far apart as they are by {1e3 * mapping.spread:.0f} "
        "mm. Is it this robot, and are the rows of joints and points the same poses?"
    )


def _other_readings(mapping: JointMapping, figures: np.ndarray) -> bool:
    """Whether rivals read the joints otherwise, which a joint that never moves does not."""
    own = readings_of(mapping.taken.hypothesis, figures)
    return any(np.nanmax(np.abs(readings_of(one.hypothesis, figures) - own)) > ONE_POSE for one in mapping.rivals)


def _ways(mapping: JointMapping, joined: Joined) -> str:
    every = [mapping.taken, *mapping.rivals][:3]
    return "; ".join(
        ", ".join(
            f"{'-' * (s < 0)}{joined.columns[c].name}"
            for c, s in zip(one.hypothesis.columns, one.hypothesis.signs, strict=True)
        )
        for one in every
    )


# The measurements.


def _made(
    joined: Joined, choice: Choice, markers: tuple[str, list[str] | None], flange: FlangeKinematics,
    sigma_rotation: float | None, notes: list[str],
) -> ImportProposal:  # fmt: skip
    points, unit = choice.points, choice.unit
    robot, figures, taken = flange.robot, joined.figures, choice.mapping.taken
    readings = readings_of(taken.hypothesis, figures)
    position = figures[:, points] * SCALES[unit]
    good = np.isfinite(readings).all(axis=1) & np.isfinite(position).all(axis=1)
    if not good.all():
        notes.append(f"{int((~good).sum())} of {len(good)} rows lack joints or a point, and are left out")
    columns: dict[str, object] = {}
    origins: list[ColumnOrigin] = []
    fit = f"the nominal robot is then {1e3 * taken.error:.2g} mm off (median)"
    columns["pose"], origin = _poses(joined, readings)
    origins.append(origin)
    if markers[1] is not None:
        columns["marker"] = markers[1]
        origins.append(_label_origin(joined, "marker"))
    if "payload" in joined.roles.labels:
        names = {name.lower(): name for name in robot.payloads}
        columns["payload"] = [
            names[str(cell).lower()] if cell else "" for cell in joined.columns[joined.roles.labels["payload"]].cells
        ]
        origins.append(_label_origin(joined, "payload"))
    if joined.roles.time is not None:
        clock = joined.columns[joined.roles.time]
        columns["time_s"] = np.round(seconds(clock) - np.nanmin(seconds(clock)), 6)
        origins.append(
            ColumnOrigin("time_s", clock.title, "s since the first row", "its name" if clock.name else "it only grows")
        )
    if joined.roles.temperature is not None:
        warm = joined.columns[joined.roles.temperature]
        columns[f"temperature_{'K' if warm.unit == 'K' else 'degC'}"] = warm.figures
        origins.append(ColumnOrigin("temperature", warm.title, "as it is", "its name and unit"))
    for k, i in enumerate(robot.driven):
        shown, factor = robot.joints[i].shown
        column, sign = joined.columns[taken.hypothesis.columns[k]], taken.hypothesis.signs[k]
        name = f"q{i + 1}_{shown}"
        columns[name] = readings[:, k] * factor
        changed = [*(["sign turned"] if sign < 0 else []), *_from_unit(taken.hypothesis.factors[k], shown)]
        named = bool(joined.roles.joints)
        reason = (
            f"its name; {fit}"
            if named and not k
            else "its name"
            if named
            else f"by the robot's kinematics; {fit}"
            if not k
            else "so too"
        )
        if sign < 0:
            reason = "with its sign turned the robot fits, else it does not"
        origins.append(ColumnOrigin(name, column.title, ", ".join(changed) or "as it is", reason))
    for axis, k in zip("xyz", points, strict=True):
        said = joined.columns[k].unit
        why = "its name" if joined.roles.points and choice.group != ONLY else "the only three that fit"
        why = f"{why}, unit by the robot's size" if not said else why
        columns[f"{axis}_mm"] = 1e3 * position[:, "xyz".index(axis)]
        origins.append(
            ColumnOrigin(f"{axis}_mm", joined.columns[k].title, "as it is" if unit == "mm" else f"from {unit}", why)
        )
    if abs(taken.scale - 1) > 0.02:
        notes.append(f"the points are {taken.scale:.3g} times as far apart as the robot's: is their unit {unit}?")
    stated = np.array(robot.markers[markers[0]].point)
    if np.linalg.norm(taken.marker - stated) > 0.02:
        place = ", ".join(f"{1e3 * v:.0f}" for v in taken.marker)
        notes.append(
            f"marker '{markers[0]}' is near ({place}) mm by these points, and elsewhere in the robot file: known = false there lets"
            " the poses say where"
        )
    if choice.mapping.untold and ("stated",) not in joined.roles.joints:
        each = [" with ".join(f"q{robot.driven[k] + 1}" for k in joints) for joints in choice.mapping.untold]
        notes.append(f"the sign of {', and of '.join(each)} cannot be told: the points fit as well with it turned")
    if joined.roles.turns:
        turned, sources = _orientations(joined, readings, good, flange, sigma_rotation, notes)
        columns |= turned
        origins += sources
    table = pd.DataFrame(columns)[good].reset_index(drop=True)
    return ImportProposal(table, tuple(origins), tuple(notes))


def _orientations(
    joined: Joined,
    readings: np.ndarray,
    good: np.ndarray,
    flange: FlangeKinematics,
    sigma: float | None,
    notes: list[str],
) -> tuple[dict[str, np.ndarray], list[ColumnOrigin]]:
    """The columns of measured orientations, where convention, tool and standard deviation are known; else a note."""
    members = next(iter(joined.roles.turns.values()))
    rows = tuple(replace(one, figures=one.figures[good]) for one in joined.columns)
    found = told_orientations(rows, members, flange.at(readings[good])[1])
    if found is None:
        notes.append("orientations are left out: in no convention do they turn as the robot does")
        return {}, []
    if flange.robot.tool_rotation is None or sigma is None:
        tool = ", ".join(f"{np.rad2deg(angle):.1f}" for angle in found.tool)
        wanted = [
            *([f"tool_rotation_deg = [{tool}] in the robot file"] if flange.robot.tool_rotation is None else []),
            *(["--sigma-rotation-mrad"] if sigma is None else []),
        ]
        notes.append(f"orientations ({found.convention}) are left out: with {' and '.join(wanted)} they come in")
        return {}, []
    parts = np.full((len(good), 4), np.nan)
    parts[good] = found.turns.as_quat(canonical=True, scalar_first=True)
    theirs = ", ".join(joined.columns[k].title for k in found.columns)
    said = ColumnOrigin(
        "qw … qz", theirs, f"from {found.convention}", "so they turn as the robot does, and in no other way"
    )
    stated = ColumnOrigin("sigma_rotation_mrad", "", f"{1e3 * sigma:g}", "stated")
    own = dict(zip(("qw", "qx", "qy", "qz"), parts.T, strict=True))
    return {**own, "sigma_rotation_mrad": np.full(len(good), 1e3 * sigma)}, [said, stated]


def _from_unit(factor: float, shown: str) -> list[str]:
    unit = next(
        name
        for name, value in FACTORS.items()
        if value == factor and (name in ("deg", "rad", "mrad")) == (shown == "deg")
    )
    return [] if unit == shown else [f"from {unit}"]


def _label_origin(joined: Joined, label: str) -> ColumnOrigin:
    return ColumnOrigin(
        label, joined.columns[joined.roles.labels[label]].title, "as it is", "it holds the robot file's names"
    )


def _poses(joined: Joined, readings: np.ndarray) -> tuple[list[str], ColumnOrigin]:
    """Each row's pose: as a column names it where that agrees with the readings, else rows of nearly equal readings."""
    numbers = _clusters(readings)
    if "pose" in joined.roles.labels:
        column = joined.columns[joined.roles.labels["pose"]]
        names = [f"{v:g}" for v in column.figures] if column.is_figures else [str(cell) for cell in column.cells]
        pairs = set(zip(names, numbers, strict=True))
        if all(names) and len(pairs) == len(set(names)) == len(set(numbers)):
            return names, ColumnOrigin("pose", column.title, "as it is", "its name, and rows of one have equal joints")
    count = len(set(numbers))
    return [str(k) for k in numbers], ColumnOrigin(
        "pose", "", "numbered", f"rows of equal joints are one pose: {count}"
    )


def _clusters(readings: np.ndarray) -> list[int]:
    """Numbers from 1 for rows of nearly equal readings (n_rows, n), in order of appearance."""
    leaders = np.empty((0, readings.shape[1]))
    numbers = []
    for row in readings:
        near = np.flatnonzero((np.abs(leaders - row) < ONE_POSE).all(axis=1))
        if len(near):
            numbers.append(int(near[0]) + 1)
        else:
            leaders = np.vstack([leaders, row])
            numbers.append(len(leaders))
    return numbers


def stated_columns(pairs: Sequence[str]) -> dict[str, str]:
    """Return what options `OURS=NAME` state.

    Raises:
        InputError: one is no such pair, or names no column that can be stated.
    """
    known = ("q1_deg", "q1_rad", "q1_mm", "q1_m", *(f"{axis}_{unit}" for axis in "xyz" for unit in SCALES), "time_s", "pose",
             "marker", "payload")  # fmt: skip
    stated = {}
    for pair in pairs:
        ours, sign, theirs = pair.partition("=")
        kind = "q1" + ours[ours.find("_") :] if ours[:1] == "q" and ours[1:].split("_")[0].isdigit() else ours
        if not sign or not theirs or kind not in known:
            raise refuse(f"expected OURS=NAME, found '{pair}'{nearest(ours, known)}", key="--column")
        stated[ours] = theirs
    return stated
