"""Conversion of a measurement file's cells, or of arrays, to one checked table in SI units, with errors by line.

It defines the columns: their names and dimensions, the conditions they hold, and their names and units in a file.
Labels, and the columns of joints without a drive of their own, may be left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calflow.files.deferred import Rotation, pd
from calflow.files.problems import (
    MOST_TOLD,
    InputError,
    Problem,
    limited_problems,
    nearest,
    refuse,
    refuse_any,
    truncated,
)
from calflow.files.tables import NUMBER, changed, unquoted
from calflow.files.units import LARGEST, SUFFIXES, split_unit, to_si
from calflow.files.words import plural
from calflow.measurements.cells import EMPTY, MAX_ROWS_TOLD, Dialect, at_rows, read_cells
from calflow.robot.frames import angles
from calflow.robot.mechanism import BY_JOINT
from calflow.robot.robot import Robot

FOREIGN = (
    'if columns have names of their own, say q1_deg = "its name" … under the study\'s [measurements.columns], or let '
    "'calflow import' find out which is which"
)
OWN_NAMES = "rows to predict have calflow's names of columns, whatever the study's measurements call theirs"
LABELS = ("pose", "repeat", "marker", "payload", "session", "split")
AMBIENT = (213.15, 423.15)  # K: temperatures at which robots are measured
BLOCKS = ("payload", "session")  # strata within which poses are held out and resampled
POSITION = ("x", "y", "z")
ANGLES, QUATERNION = ("rx", "ry", "rz"), ("qw", "qx", "qy", "qz")
SIGMAS = ("sigma", "sigma_rotation")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
# Stems of the columns that exist once per joint, by condition: readings first.
STEMS = {"reading": "q"} | {name: name for name in BY_JOINT} | {"torque": "tau"}
FRAME = "frame"  # column of the name of a target's frame
LEAST_SIGMA = 1e-15  # m or rad; dividing by less overflows
MOVED = 0.02  # rad or m: largest difference between two readings of one pose
IN_ORDER = "in_order = true: approach directions and travel follow from the order of the rows"
NOT_IN_ORDER = (
    "in_order = true changes nothing: the rows state approach1 …, and travel is derived only where they do not"
)
AGREES = {"rad": np.deg2rad(0.5), "m": 1e-3}  # largest error of the variable that a file states of a follower
_FIGURE = re.compile(NUMBER)
NOTHING = ("", "nan", "-nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none")
WRONG_UNIT = (
    1000.0  # factor on the largest plausible value up to which a value is read, and may be reported as of a wrong unit
)
CONDITIONS = (*BY_JOINT, "wrench", "time", "temperature")


@dataclass(frozen=True)
class Reported:
    """The columns of a kind of measurement, with their dimensions ('' for a plain number).

    needed, optional: columns of measured values; labels: text columns that name the touched object; measured: False for
    target poses, which need no joint readings, order or noise; sigma: dimension of the standard deviation; within:
    required columns that distinguish the rows of one standstill; notes: text columns that only messages use.
    """

    needed: Mapping[str, str]
    optional: Mapping[str, str] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    measured: bool = True
    sigma: str = "length"
    within: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> tuple[str, ...]:
        """The columns of measured values."""
        return (*self.needed, *self.optional)


POSES = Reported(dict.fromkeys(POSITION, "length"), dict.fromkeys(ANGLES, "angle") | dict.fromkeys(QUATERNION, ""))

TARGETS = replace(POSES, labels=(FRAME,), measured=False)


def blocks_of(table: pd.DataFrame) -> list[str]:
    """Return those of the columns payload and session that the table has."""
    return [name for name in BLOCKS if name in table]


def condition_columns(condition: str, robot: Robot) -> list[str]:
    """Return the columns of a table that hold a condition."""
    if condition == "wrench":
        return list(WRENCH)
    return numbered(STEMS[condition], robot.n_joints) if condition in STEMS else [condition]


def column_names(robot: Robot, reported: Reported = POSES) -> dict[str, str]:
    """Return the dimension ('' for none) of every column a measurement file may have, by its name without unit."""
    n = robot.n_joints
    names = dict.fromkeys((*LABELS, *reported.labels, *reported.notes, *numbered("approach", n)), "")
    for stem, kind in {"q": "", "travel": "", "speed": "speed", "acceleration": "acceleration"}.items():
        angular, along = (f"angular {kind}", kind) if kind else ("angle", "length")
        names |= {f"{stem}{i + 1}": angular if j.kind == "revolute" else along for i, j in enumerate(robot.joints)}
    names |= {"sigma": reported.sigma, **reported.needed, **reported.optional, **reported.within}
    names |= dict.fromkeys(("nominal_x", "nominal_y", "nominal_z"), "length")  # of a completed select/poses.csv
    names |= {f"via{i + 1}": names[f"q{i + 1}"] for i in range(n)}  # of the same
    names |= dict.fromkeys(("target_x", "target_y", "target_z"), "length")  # targets of compensated commands
    names |= {"sigma_rotation": "angle"}
    names |= dict.fromkeys(WRENCH[:3], "force") | dict.fromkeys(WRENCH[3:], "moment")
    names |= dict.fromkeys(numbered("tau", n), "moment")
    return names | {"time": "time", "temperature": "temperature"}


def numbered(stem: str, n: int) -> list[str]:
    """Return the stem with the numbers 1 to n appended."""
    return [f"{stem}{i + 1}" for i in range(n)]


def split_column(spelled: str, robot: Robot, reported: Reported = POSES) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit ('' if it has none)."""
    return (spelled, "") if column_names(robot, reported).get(spelled) == "" else split_unit(spelled)


Missing = Literal["whole", "refuse", "skip"]


@dataclass(frozen=True)
class Layout(Dialect):
    """The layout of a measurement file: its dialect and the meaning of its columns.

    columns maps calflow's names to a foreign file's; markers does so for files with several markers side by side.
    sigma [m] and sigma_rotation [rad] hold for all rows. in_order states that the rows are in measuring order, so that
    approach directions follow from the pose before. tracker [m] is the device's position in the measuring frame, if not
    its origin. missing states which rows are left out and counted: "whole", rows without any measured value (rows that
    lack only some are errors); "skip", rows that lack any; "refuse", none. reports are the columns of measured values.

    Raises:
        ValueError: the dialect is invalid.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    markers: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    sigma: float | None = None
    sigma_rotation: float | None = None
    in_order: bool = False
    tracker: tuple[float, float, float] | None = None
    missing: Missing = "whole"
    reports: Reported = POSES

    @property
    def named(self) -> list[str]:
        """The foreign file's columns that columns and markers name."""
        return [*self.columns.values(), *(name for marker in self.markers.values() for name in marker.values())]


@dataclass(frozen=True)
class ReadColumn:
    """A column to be read: name and unit, ours (`name_unit`), theirs (the file's name) and marker ('': all markers)."""

    name: str
    unit: str
    ours: str
    theirs: str
    marker: str = ""

    def __str__(self) -> str:
        return f"column '{self.theirs}'" + (f" ({self.ours})" if self.ours != self.theirs else "")


def columns_read(there: Sequence[str], layout: Layout, robot: Robot, path: Path) -> list[ReadColumn]:
    """Return the columns to be read: those that the layout names, or all if it names none.

    Raises:
        InputError: the file lacks columns that the layout names.
    """
    names = set(there)
    absent = [name for name in dict.fromkeys(layout.named) if name not in names]
    wrong = "no column '{}', which the study's mapping names{}"
    line = layout.header_line or None
    refuse_any(limited_problems(absent, lambda name: Problem(wrong.format(name, nearest(name, there)), path, line)))
    pairs = [("", ours, theirs) for ours, theirs in layout.columns.items()]
    pairs += [(marker, ours, theirs) for marker, columns in layout.markers.items() for ours, theirs in columns.items()]
    if not pairs:
        pairs = [("", name, name) for name in there]
    return [
        ReadColumn(*split_column(ours, robot, layout.reports), ours, theirs, marker) for marker, ours, theirs in pairs
    ]


def check_header(columns: Sequence[ReadColumn], layout: Layout, robot: Robot, conditions_only: bool) -> list[str]:
    """Return messages on columns that are unknown, duplicate, without unit, missing or contradictory."""
    allowed = column_names(robot, layout.reports)
    first = {(column.name, column.marker): column for column in reversed(columns)}
    wrong = [
        column for column in columns
        if _doubled(column, first) or not _is_known(column, allowed) or (conditions_only and column.name in layout.reports.values)
    ]  # fmt: skip
    unknown = [_mistake(column, first, allowed) for column in wrong[:MOST_TOLD]]
    if len(wrong) > MOST_TOLD:
        unknown.append(f"and {plural(len(wrong) - MOST_TOLD, 'more column')} like these")
    missing: list[str] = []
    for marker in dict.fromkeys([column.marker for column in columns if column.marker] or [""]):
        columns_of = {column.name: column for column in columns if column.marker in ("", marker)}
        missing += _missing(columns_of, marker, layout, robot, conditions_only)
    foreign = any(column.name not in allowed and not _near(column, allowed) for column in wrong[:MOST_TOLD])
    if foreign and missing and not (layout.columns or layout.markers):
        missing.append(OWN_NAMES if conditions_only else FOREIGN)
    names = {column.name: column for column in columns}
    twice = [
        f"{names[name]}: the study's [measurements] states {name} too; expected one of them"
        for name, stated in (("sigma", layout.sigma), ("sigma_rotation", layout.sigma_rotation))
        if stated is not None and name in names
    ]
    oriented = not conditions_only and layout.reports.measured and bool({"rx", "qw"} & names.keys())
    unsure = layout.sigma_rotation is None and "sigma_rotation" not in names
    turns = {
        "has measured orientations, but the robot file does not say how the tool is turned: expected "
        "tool_rotation_deg (or _rad) = [rx, ry, rz] there": oriented and robot.tool_rotation is None,
        "has measured orientations, but not how sure they are: expected a column sigma_rotation_mrad (or _rad, "
        "_deg), or sigma_rotation_mrad = … in the study's [measurements]": oriented and unsure,
        "has orientations twice, as rx, ry, rz and as a quaternion: expected one of them": {"rx", "qw"} <= names.keys(),
    }
    return list(dict.fromkeys((*unknown, *missing, *twice, *(words for words, true in turns.items() if true))))


Columns = Mapping[tuple[str, str], ReadColumn]  # by name and marker


def _doubled(column: ReadColumn, first: Columns) -> bool:
    """Whether an earlier column, of all markers or of the same marker, has the column's name."""
    return first.get((column.name, ""), first[column.name, column.marker]) is not column


def _is_known(column: ReadColumn, names: Mapping[str, str]) -> bool:
    """Whether a column has one of calflow's names, with a unit of the right dimension."""
    return column.name in names and column.unit in SUFFIXES.get(names[column.name], ("",))


def _near(column: ReadColumn, names: Mapping[str, str]) -> str:
    """Return which name a wrong one may stand for, or that the robot has no such joint; empty where nothing is near."""
    every = [f"{n}_{s}" if s else n for n, d in names.items() for s in SUFFIXES.get(d, ("",))]
    if re.fullmatch("q[0-9]+", column.name):
        return f": the robot file has {plural(sum(name[:1] == 'q' and name[1:].isdigit() for name in names), 'joint')}"
    return nearest(column.ours, every)


def _mistake(column: ReadColumn, first: Columns, names: Mapping[str, str]) -> str:
    """Return the message on a column's wrong name."""
    name = column.name
    if _doubled(column, first):
        return f"{column}: '{name}' is there twice, in different units"
    if name not in names or (column.unit and not names[name]):
        return f"unknown {column}{_near(column, names)}"
    if not _is_known(column, names):
        wanted = ", ".join(f"{name}_{suffix}" for suffix in SUFFIXES[names[name]])
        return f"{column} needs a unit of {names[name]} in its name: {wanted}"
    return f"{column} is what will be predicted: leave it out of the rows"


def _missing(
    columns: dict[str, ReadColumn], marker: str, layout: Layout, robot: Robot, conditions_only: bool
) -> list[str]:
    """Return messages on the required columns that the rows of a marker ('' for all) lack."""
    n, names = robot.n_joints, column_names(robot, layout.reports)
    required = numbered("q", n) if layout.reports.measured else []
    required += [] if conditions_only else [*layout.reports.needed, *layout.reports.within]
    if len(robot.markers) > 1 and not marker:
        required.append("marker")
    groups = [*(numbered(stem, n) for stem in STEMS.values()), WRENCH, ANGLES, QUATERNION]
    if not layout.reports.measured:  # external axes are stated where the arm's joints are asked for
        groups[0] = [f"q{joint + 1}" for joint in robot.arm]
    required += [name for group in groups if columns.keys() & set(group) for name in group]
    following = {f"{stem}{joint + 1}" for joint in robot.followers for stem in STEMS.values()}
    where = ""
    if layout.columns or layout.markers:
        place = f"markers.{marker}" if marker else "columns"
        where = f" in the study's [measurements.{place}]"
    return [
        f"missing column: expected {' or '.join(f'{name}_{s}' if s else name for s in SUFFIXES.get(names[name], ('',)))}{where}"
        for name in dict.fromkeys(required)
        if name not in columns and name not in following
    ]


def check_values(table: pd.DataFrame, robot: Robot, path: Path | None, reported: Reported = POSES) -> list[Problem]:
    """Return problems of names unknown to the robot, rows that contradict each other, and values out of range."""
    problems = [*_names(table, robot, path), *_figures(table, robot, path)]
    if "split" in table:
        split = table["split"].where(table["split"].isin(["train", "holdout"]))
        problems += at_rows(split.isna(), table, path, "split: expected 'train' or 'holdout'")
        mixed = split.groupby(table["pose"]).transform("nunique") > 1
        problems += at_rows(mixed, table, path, "split: one pose is in train and in holdout; held out is a whole pose")
    keys = ["repeat", *_repeat_keys(table, reported)]
    twice = table.duplicated(keys, keep="first") & (table["pose"] != "")
    first = table.groupby(keys, dropna=False, sort=False)["line"].transform("first")
    problems += at_rows(twice, table, path, "duplicate pose: the same pose, repeat and marker stand", first)
    joints = table[numbered("q", robot.n_joints)]
    moved = (joints - joints.groupby(table["pose"]).transform("first")).abs().max(axis=1) > MOVED
    problems += at_rows(
        moved & ~twice,
        table,
        path,
        "duplicate pose: give each pose a number of its own, or leave out the column pose; this number has other joint readings",
        table.groupby("pose", sort=False)["line"].transform("first"),
    )
    return problems


def _names(table: pd.DataFrame, robot: Robot, path: Path | None) -> list[Problem]:
    problems: list[Problem] = []
    for name, allowed, optional in (("marker", robot.markers, False), ("payload", robot.payloads, True)):
        unknown = [value for value in table[name].unique() if value not in allowed and not (optional and value == "")]
        names = ", ".join(allowed) or "none"
        for value in unknown[:MOST_TOLD]:
            unlike = f"unknown {name} '{value}'" if value else f"column '{name}' is empty"
            problems += at_rows(table[name] == value, table, path,
                                f"{unlike}; the robot file has {names}{nearest(value, allowed)}")  # fmt: skip
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
    if "temperature" in table:
        wild = ~table["temperature"].between(*AMBIENT) & table["temperature"].notna()
        low, high = (kelvin - 273.15 for kelvin in AMBIENT)
        expected = f"expected {low:g} to {high:g} °C; is it in another unit, or a sign for no value?"
        problems += at_rows(wild, table, path, f"temperature: {expected}")
    if "qw" in table:
        norm = np.linalg.norm(table[[*QUATERNION]], axis=1)
        problems += at_rows(np.abs(norm - 1) > 0.01, table, path, "qw, qx, qy, qz: expected a quaternion of norm 1")
    return problems


def layout_of_further(path: Path, layout: Layout) -> Layout:
    """Return the layout of a series' further file: the series' own, or calflow's names if none of its columns exist.

    The latter are files of poses that calflow proposed, completed with the measured values.
    """
    if not layout.named or set(layout.named) & set(map(str, read_cells(path, layout, layout.named))):
        return layout
    return replace(layout, columns={}, markers={})


def ordered(table: pd.DataFrame, robot: Robot, in_order: bool) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows with their position in measuring order and, if in_order, their approach and travel; and notes.

    If the file has approach columns they stay unchanged, and no travel is added.
    """
    table = table.copy()
    table["order"] = table["time"].rank(method="dense") if "time" in table else np.arange(1.0, len(table) + 1)
    if not in_order:
        return table, []
    if "approach1" in table:
        return table, [NOT_IN_ORDER]
    approach, travel = approach_and_travel(table, numbered("q", robot.n_joints))
    table[numbered("approach", robot.n_joints)] = approach
    table[numbered("travel", robot.n_joints)] = travel
    return table, [IN_ORDER]


def ranged(table: pd.DataFrame, robot: Robot, tracker: tuple[float, float, float] | None) -> pd.DataFrame:
    """Return the rows with their range [m] from the device at tracker [m], if its position is known."""
    at_origin = robot.base.known and not np.any(robot.base.origin)
    if "x" not in table or (tracker is None and at_origin):
        return table
    return table.assign(range=np.linalg.norm(table[[*POSITION]] - np.array(tracker or (0.0, 0.0, 0.0)), axis=1))


def approach_and_travel(table: pd.DataFrame, readings: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return each row's approach directions and the travel since each joint's last reversal, (n_rows, n_joints) each.

    Consecutive rows of one pose are one standstill: differences between their readings are encoder jitter.
    """
    rows = table.sort_values("order", kind="stable")
    if "pose" in rows:
        rows = rows.groupby((rows["pose"] != rows["pose"].shift()).cumsum())[readings].transform("first")
    approach, travel = sides_and_travel(rows[readings].to_numpy())
    original = np.argsort(np.argsort(table["order"].to_numpy(), kind="stable"), kind="stable")
    return approach[original], travel[original]


def sides_and_travel(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return approach directions and travel since the last reversal of ordered joint readings (n, n_joints)."""
    step = np.diff(q, axis=0, prepend=q[:1])
    row = np.arange(len(q))[:, None]
    # The last row at which a joint moved: a joint at rest keeps its approach direction.
    moved = np.maximum.accumulate(np.where(step != 0, row, 0), axis=0)
    approach = np.take_along_axis(np.sign(step), moved, axis=0)
    turned = np.diff(approach, axis=0, prepend=approach[:1]) != 0
    total = np.cumsum(np.abs(step), axis=0)
    before = np.take_along_axis(total - np.abs(step), np.maximum.accumulate(np.where(turned, row, 0), axis=0), axis=0)
    return approach, total - before


def filled(table: pd.DataFrame, robot: Robot, path: Path | None) -> tuple[pd.DataFrame, list[Problem]]:
    """Return the rows with readings of 0 for joints without their own drive, and problems of contradicting columns.

    Such a column must be 0 throughout, or hold the variable that follows from the couplings, up to a constant offset.
    """
    problems = []
    for joint in robot.followers:
        name = f"q{joint + 1}"
        if name in table and (wrong := _contradiction(table, robot, joint, path)):
            problems.append(wrong)
        stems = [stem for stem in STEMS.values() if any(f"{stem}{i + 1}" in table for i in robot.driven)]
        table = table.assign(**{f"{stem}{joint + 1}": 0.0 for stem in stems})
    return table, problems


def _contradiction(table: pd.DataFrame, robot: Robot, joint: int, path: Path | None) -> Problem | None:
    """Return the problem if a table's column of a follower (counted from 0) contradicts its couplings, else None."""
    stated = table[f"q{joint + 1}"].to_numpy(dtype=float)
    computed = np.zeros(len(table))
    for coupling in robot.couplings:
        if coupling.joint == joint + 1 and f"q{coupling.source}" in table:
            computed += coupling.factor * table[f"q{coupling.source}"].to_numpy(dtype=float)
    difference = stated - computed
    compared = np.isfinite(difference)
    if not compared.any() or not stated[compared].any():
        return None
    error = np.abs(difference - np.median(difference[compared]))
    bad = np.flatnonzero(compared & (error > AGREES[robot.joints[joint].unit]))
    if not len(bad):
        return None
    line = int(table["line"].iloc[bad[0]]) if "line" in table and path else None
    leaders = " and ".join(f"q{coupling.source}" for coupling in robot.couplings if coupling.joint == joint + 1)
    unit, factor = robot.joints[joint].shown
    return Problem(
        f"q{joint + 1}: joint {joint + 1} has no drive of its own, it follows {leaders}: expected no column q{joint + 1}, or the "
        f"joint's own {robot.joints[joint].noun}; off by up to {factor * float(error[bad].max()):.3g} {unit} in "
        f"{plural(len(bad), 'row')}",
        path,
        line,
    )


def labelled(table: pd.DataFrame, robot: Robot, reported: Reported = POSES) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows with all labels, and notes on assumed ones."""
    table = table.copy()
    notes = []
    if "marker" not in table:
        table["marker"] = next(iter(robot.markers))
    if "payload" not in table:
        table["payload"] = ""
        if robot.payloads:
            notes.append(f"no column 'payload': no row counts as carrying {' or '.join(robot.payloads)}")
    if "pose" not in table:
        keys = [*numbered("q", robot.n_joints), "payload"]
        table["pose"] = table.groupby(keys, sort=False, dropna=False).ngroup() + 1
        notes.append(
            f"no column 'pose': rows with equal joint readings and payload count as one pose ({table['pose'].nunique()})"
        )
    if "repeat" not in table:
        table["repeat"] = table.groupby(_repeat_keys(table, reported), dropna=False).cumcount() + 1
    return table, notes


def _repeat_keys(table: pd.DataFrame, reported: Reported) -> list[str]:
    """Return the columns in which repeats of one value agree."""
    within = [*reported.labels, *reported.within] if reported.within else []
    return ["pose", "marker", *(name for name in within if name in table)]


@dataclass(frozen=True)
class Values:
    """A column's values by line, nan where there are none; the mask of empty cells; and the problems of the others."""

    values: pd.Series
    empty: pd.Series
    problems: list[Problem]


def values_of(cells: pd.Series, column: ReadColumn, layout: Layout, path: Path) -> Values:
    """Return a column's values: labels as text, or numbers in SI units."""
    never = pd.Series(False, cells.index)
    if column.name in ("marker", "payload", "session", "split", *layout.reports.labels, *layout.reports.notes):
        return Values(_label(cells), never, [])
    if column.name in ("pose", "repeat"):
        labels = _label(cells).str.replace(r"\.0*$", "", regex=True)
        problems = at_lines(labels == "", path, f"{column} is empty")
        whole = labels.str.fullmatch(r"[0-9]{1,18}").all()
        return Values(labels.astype(int) if whole else labels, never, problems)
    return numbers(cells, column, layout, path)


def numbers(cells: pd.Series, column: ReadColumn, layout: Layout, path: Path) -> Values:
    """Return a column's numbers in SI units."""
    if pd.api.types.is_numeric_dtype(cells):
        figures, text = cells.astype(float), pd.Series(False, cells.index)
        empty = ~pd.Series(np.isfinite(figures), cells.index)
    else:
        written = _text(cells).tolist()  # of some hundred cells a list takes a tenth of the time
        if layout.decimal == ",":
            written = [text.replace(".", "?").replace(",", ".") for text in written]
        # A figure beyond the range of floating point becomes infinite.
        parsed = [float(text) if _FIGURE.fullmatch(text) else None for text in written]
        wrong = [value is None and text.lower() not in NOTHING for value, text in zip(parsed, written, strict=True)]
        text = pd.Series(wrong, cells.index, dtype=bool)
        figures = pd.Series(parsed, cells.index, dtype=float)
        empty = figures.isna() & ~text
    factor, offset = to_si(column.unit) if column.unit else (1.0, 0.0)
    values = factor * figures + offset
    dimension = next((name for name, units in SUFFIXES.items() if column.unit in units), "")
    large = pd.Series(beyond_largest(values.where(~empty, 0.0).to_numpy(), dimension), cells.index)
    problems = [Problem(_no_number(cells[text], column, layout), path, int(cells.index[text][0]))] if text.any() else []
    problems += at_lines(large, path, f"{column}: {limit_message(dimension)}")
    return Values(values.where(~(empty | large)), empty, problems)


def at_lines(bad: pd.Series, path: Path, message: str) -> list[Problem]:
    """Return a problem for each of the first few bad cells, and one that counts the others."""
    return at_rows(bad, pd.DataFrame({"line": bad.index}), path, message) if bad.any() else []


def beyond_largest(values: np.ndarray, dimension: str) -> np.ndarray:
    """Return the mask of values [SI] too large even for a wrong unit, in the shape of values."""
    return np.abs(values) > WRONG_UNIT * LARGEST[dimension]


def limit_message(dimension: str) -> str:
    """Return the message that states the largest value that is read."""
    si = f" {SUFFIXES[dimension][0]}" if dimension else ""
    return f"expected at most {WRONG_UNIT * LARGEST[dimension]:g}{si}"


def _no_number(wrong: pd.Series, column: ReadColumn, layout: Layout) -> str:
    """Return the message on cells that are not numbers."""
    first, more = truncated(str(wrong.iloc[0])), len(wrong) - 1
    other = "," if layout.decimal == "." else "."
    hint = f" (written with '{other}'? say decimal = \"{other}\" in the study)" if other in first else ""
    count = f" (and {plural(more, 'more row')})" if more else ""
    return f"{column}: expected a number, found '{first}'{hint}{count}"


def _label(cells: pd.Series) -> pd.Series:
    return changed(_text(cells), unquoted)


def _text(cells: pd.Series) -> pd.Series:
    return cells.where(cells.notna(), "").astype(str)


@dataclass(frozen=True)
class Rows:
    """A table in SI units, notes on assumptions, the time_s [s] at which its time is zero, and the file's units.

    payload_stated: whether the rows say what is carried; where they do not, nothing counts as carried.
    """

    table: pd.DataFrame
    notes: tuple[str, ...]
    time_origin: float | None
    payload_stated: bool
    units: tuple[str, ...] = ()


def read_rows(
    path: Path, robot: Robot, layout: Layout, conditions_only: bool = False, time_origin: float | None = None
) -> Rows:
    """Read and check a measurement file.

    Args:
        path: a CSV, or a MATLAB file whose arrays become columns `name_1`, `name_2`, …
        robot: defines the joints, payloads and markers.
        layout: the layout of the file.
        conditions_only: whether the rows are to be predicted, so that x, y and z are not needed.
        time_origin: the time_s [s] at which time is zero; None: that of the earliest row.

    Raises:
        InputError: with everything that is wrong in the file.
    """
    cells = read_cells(path, layout, layout.named)
    columns = columns_read(list(map(str, cells)), layout, robot, path)
    problems = [
        Problem(message, path, layout.header_line or None)
        for message in check_header(columns, layout, robot, conditions_only)
    ]
    names = column_names(robot, layout.reports)
    read = {
        column: values_of(cells[column.theirs], column, layout, path) for column in columns if _is_known(column, names)
    }
    void = _without_measurement(read, layout)
    wrong = [
        problem
        for column, values in read.items()
        for problem in (*_empty(column, values, void, layout, path), *values.problems)
    ]
    if problems:
        raise InputError(problems + wrong)
    planned = conditions_only or not layout.reports.measured
    units = tuple(sorted({column.unit for column in read}))
    return _completed(_assembled(read, void, layout), robot, layout, path, wrong, planned, time_origin, units)


def _completed(
    table: pd.DataFrame, robot: Robot, layout: Layout, path: Path | None, wrong: Sequence[Problem], planned: bool,
    time_origin: float | None, units: tuple[str, ...] = (),
) -> Rows:  # fmt: skip
    """Return the checked rows with derived columns: followers, labels, relative time, order, range, approach, travel.

    Raises:
        InputError: with the problems in wrong and all further ones.
    """
    payload_stated = "payload" in table
    table, following = filled(table, robot, path)
    table, notes = labelled(table if layout.reports.measured else _as_targets(table, robot), robot, layout.reports)
    refuse_any([*wrong, *following, *check_values(table, robot, path, layout.reports)])
    origin = None
    if "time" in table:
        origin = float(table["time"].min()) if time_origin is None else time_origin
        table = table.assign(time=table["time"] - origin)
    if not planned:
        table, in_order = ordered(ranged(table, robot, layout.tracker), robot, layout.in_order)
        notes += in_order
    table, left_out = kept(table, layout, path)
    return Rows(table, (*notes, *left_out), origin, payload_stated, units)


def _without_measurement(read: dict[ReadColumn, Values], layout: Layout) -> dict[str, pd.Series]:
    """Return, by marker ('' if markers have no columns of their own), the mask of lines left out for missing values."""
    void = {}
    for marker in dict.fromkeys([column.marker for column in read if column.marker] or [""]):
        measured = [
            values.empty
            for column, values in read.items()
            if column.name in layout.reports.values and column.marker in ("", marker)
        ]
        if not measured:
            void[marker] = pd.Series(dtype=bool)
            continue
        empty = pd.concat(measured, axis=1)
        left_out = {"whole": empty.all(axis=1), "skip": empty.any(axis=1)}
        void[marker] = left_out.get(layout.missing, pd.Series(False, empty.index))
    return void


def _empty(column: ReadColumn, values: Values, void: dict[str, pd.Series], layout: Layout, path: Path) -> list[Problem]:
    """Return problems of empty cells, except cells of measured values in rows that are left out."""
    empty = values.empty
    if column.name in (*layout.reports.values, *SIGMAS):
        left_out = [lines for marker, lines in void.items() if column.marker in ("", marker)]
        empty = empty & ~pd.concat(left_out, axis=1).all(axis=1).reindex(empty.index, fill_value=False)
    return at_lines(empty, path, f"{column} is empty or not a number; complete the row or leave it out")


def _assembled(read: dict[ReadColumn, Values], void: dict[str, pd.Series], layout: Layout) -> pd.DataFrame:
    """Return the table of one row per line, or per line and marker where markers have columns side by side."""
    blocks = []
    for marker, lines in void.items():
        read_values = {column.name: values.values for column, values in read.items() if column.marker in ("", marker)}
        block = pd.DataFrame(
            {"line": next(iter(read_values.values())).index, **{k: v.to_numpy() for k, v in read_values.items()}}
        )
        if marker:
            block["marker"] = marker
        for name, value in (("sigma", layout.sigma), ("sigma_rotation", layout.sigma_rotation)):
            if value is not None:
                block[name] = value
        blocks.append(block.assign(missing=lines.reindex(block["line"], fill_value=False).to_numpy()))
    return pd.concat(blocks).sort_values("line", kind="stable").reset_index(drop=True)


def kept(table: pd.DataFrame, layout: Layout, path: Path | None) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows without those that the column `missing` marks, and a note with the number and lines of these.

    It comes after `ordered`: rows left out count in the measuring order, since the robot was there.
    """
    missing = table["missing"].to_numpy()
    table = table.drop(columns="missing")
    if missing.all():
        raise refuse(f"{EMPTY}; no row has a measured value", path)
    if not missing.any():
        return table, []
    lines = list(dict.fromkeys(table["line"][missing]))
    named = ", ".join(map(str, lines[:MAX_ROWS_TOLD]))
    more = f" and {len(lines) - MAX_ROWS_TOLD} more" if len(lines) > MAX_ROWS_TOLD else ""
    asked = 'missing = "skip": ' if layout.missing == "skip" else ""
    have, are = ("has", "is") if missing.sum() == 1 else ("have", "are")
    note = f"{asked}{missing.sum()} of {len(missing)} rows {have} no measured value and {are} left out (line {named}{more})"
    return table[~missing].reset_index(drop=True), [note]


def _as_targets(table: pd.DataFrame, robot: Robot) -> pd.DataFrame:
    """Return target rows completed with nan for missing readings, and with pose numbers if they have no pose names."""
    readings = {name: np.nan for name in numbered("q", robot.n_joints) if name not in table}
    poses = {} if "pose" in table else {"pose": np.arange(1, len(table) + 1)}
    return table.assign(**readings, **poses)


def rows_of(
    robot: Robot, q: ArrayLike, position: ArrayLike | None, layout: Layout, time_origin: float | None,
    more: Mapping[str, ArrayLike],
) -> Rows:  # fmt: skip
    """Return the table of arrays in SI units (see `Measurements.from_arrays`); rows count from 1.

    Raises:
        InputError: with everything that is wrong in the arrays.
    """
    given = {"q": q, "position": position, **more}
    names = ("q", "position", "rotation", *LABELS, *SIGMAS, *CONDITIONS)
    problems = [Problem(f"unknown array{nearest(name, names)}", key=name) for name in more if name not in names]
    n_rows = len(np.atleast_1d(np.asarray(q)))
    columns: dict[str, object] = {"line": np.arange(1, n_rows + 1)}
    for name, values in given.items():
        if values is None or name not in names:
            continue
        try:
            columns |= _labels(name, values, n_rows) if name in LABELS else _numbers(name, values, n_rows, robot)
        except ValueError as error:
            problems.append(Problem(str(error), key=name))
    refuse_any(problems)
    table = pd.DataFrame(columns)
    measured = [name for name in (*POSITION, *ANGLES) if name in table]
    void = table[measured].isna().all(axis=1) if measured else pd.Series(False, table.index)
    void &= not void.all()  # if nothing at all was measured, no row is left out
    refuse_any(_not_finite(table, robot, void))
    return _completed(table.assign(missing=void), robot, layout, None, (), position is None, time_origin)


def _labels(name: str, values: ArrayLike, n_rows: int) -> dict[str, pd.Series]:
    labels = np.asarray(values, dtype=object)
    if labels.ndim and labels.shape != (n_rows,):
        raise ValueError(f"expected one name, or {n_rows} of them, found shape {labels.shape}")
    return {name: pd.Series(np.broadcast_to(labels, (n_rows,))).infer_objects()}


def _numbers(name: str, values: ArrayLike, n_rows: int, robot: Robot) -> dict[str, np.ndarray]:
    array = np.asarray(values, dtype=float)
    if name == "rotation":
        if array.shape != (n_rows, 3, 3):
            raise ValueError(f"expected shape ({n_rows}, 3, 3), found {array.shape}")

        array, names = angles(Rotation.from_matrix(array)), [*ANGLES]
    else:
        names = {"q": condition_columns("reading", robot), "position": [*POSITION]}.get(name) or (
            [name] if name in SIGMAS else condition_columns(name, robot)
        )
    if array.ndim == 2 and array.shape[1] == len(robot.driven) < robot.n_joints and len(names) == robot.n_joints:
        names = [names[i] for i in robot.driven]
    wide = (n_rows, len(names))
    if array.ndim < 2 and len(names) == 1:
        array = np.broadcast_to(array.reshape(-1, 1) if array.ndim else array, wide)
    if array.shape != wide:
        raise ValueError(f"expected shape {wide if len(names) > 1 else (n_rows,)}, found {array.shape}")
    return dict(zip(names, array.T, strict=True))


def _not_finite(table: pd.DataFrame, robot: Robot, void: pd.Series) -> list[Problem]:
    """Return problems of values that are not finite, except measured ones in the rows void (n_rows,)."""
    names = column_names(robot)
    problems: list[Problem] = []
    for name in (name for name in table if name != "line" and name not in LABELS):
        values = table[name].to_numpy(dtype=float)
        excused = void.to_numpy() if name in (*POSITION, *ANGLES, *SIGMAS) else False
        problems += at_rows(~np.isfinite(values) & ~np.array(excused), table, None, f"{name}: expected a finite number")
        large = beyond_largest(np.where(np.isfinite(values), values, 0.0), names[str(name)])
        problems += at_rows(large, table, None, f"{name}: {limit_message(names[str(name)])}")
    return problems
