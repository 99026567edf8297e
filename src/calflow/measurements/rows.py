"""The rows of a measurement file: its cells as one checked table in SI units.

The labels that may be left out of measurements: marker, payload, pose and repeat.
Followers: joints that only others move have no reading, and so need no columns in measurements.
The values of a measurement file's columns: cells as numbers in SI units or as labels, and what is wrong with them.
Measurements from arrays: the checked table of rows that were never in a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from calflow.files.csv import NUMBER, changed, unquoted
from calflow.files.problems import InputError, Problem, nearest, shortened
from calflow.files.units import LARGEST, SUFFIXES, to_si
from calflow.measurements.cells import EMPTY, read_cells
from calflow.measurements.checks import MAX_ROWS_TOLD, ReadColumn, at_rows, check_header, check_values, columns_read
from calflow.measurements.columns import (
    ANGLES,
    LABELS,
    POSITION,
    SIGMAS,
    STEMS,
    column_names,
    condition_columns,
    numbered,
)
from calflow.measurements.layout import Layout
from calflow.measurements.sequence import ordered, ranged
from calflow.robot.robot import Robot
from calflow.robot.transforms import angles

AGREES = {"rad": np.deg2rad(0.5), "m": 1e-3}  # by how much what a file says of a follower may be off


def filled(table: pd.DataFrame, robot: Robot, path: Path | None) -> tuple[pd.DataFrame, list[Problem]]:
    """Return rows in which joints without a reading of their own stay where their couplings have them.

    What a file says of such a joint must be 0 throughout, or its variable, whatever that is counted from; told where it is not.
    """
    problems = []
    for joint in robot.followers:
        name = f"q{joint + 1}"
        if name in table and (wrong := _wrong(table, robot, joint, path)):
            problems.append(wrong)
        stems = [stem for stem in STEMS.values() if any(f"{stem}{i + 1}" in table for i in robot.driven)]
        table = table.assign(**{f"{stem}{joint + 1}": 0.0 for stem in stems})
    return table, problems


def _wrong(table: pd.DataFrame, robot: Robot, joint: int, path: Path | None) -> Problem | None:
    """What is wrong with what a table says of a follower, counted from 0."""
    said = table[f"q{joint + 1}"].to_numpy(dtype=float)
    computed = np.zeros(len(table))
    for coupling in robot.couplings:
        if coupling.joint == joint + 1 and f"q{coupling.source}" in table:
            computed += coupling.factor * table[f"q{coupling.source}"].to_numpy(dtype=float)
    off = said - computed
    known = np.isfinite(off)
    if not known.any() or not said[known].any():
        return None
    apart = np.abs(off - np.median(off[known]))
    bad = np.flatnonzero(known & (apart > AGREES[robot.joints[joint].unit]))
    if not len(bad):
        return None
    line = int(table["line"].iloc[bad[0]]) if "line" in table and path else None
    leaders = " and ".join(f"q{one.source}" for one in robot.couplings if one.joint == joint + 1)
    unit, factor = robot.joints[joint].shown
    return Problem(
        f"q{joint + 1}: joint {joint + 1} has no drive of its own, it follows {leaders}: expected no column q{joint + 1}, or the "
        f"joint's own {robot.joints[joint].noun}; {len(bad)} rows are off by up to {factor * float(apart[bad].max()):.3g} {unit}",
        path,
        line,
    )


def labelled(table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows with every label, and notes of what was assumed."""
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
        table["repeat"] = table.groupby(["pose", "marker"]).cumcount() + 1
    return table, notes


NOTHING = ("", "nan", "-nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none")
WRONG_UNIT = 1000.0  # times what a robot has: so far a value may lie, and be told as one in a wrong unit


@dataclass(frozen=True)
class Values:
    """A column's values by line, nan where there is none, which cells are empty, and what is wrong with the others."""

    values: pd.Series
    empty: pd.Series
    problems: list[Problem]


def values_of(cells: pd.Series, column: ReadColumn, layout: Layout, path: Path) -> Values:
    """Return a column's values in SI units."""
    never = pd.Series(False, cells.index)
    if column.name in ("marker", "payload", "session", "split", *layout.reports.labels):
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
        written = _text(cells)
        if layout.decimal == ",":
            written = written.str.replace(".", "?", regex=False).str.replace(",", ".", regex=False)
        good = written.str.fullmatch(NUMBER)
        empty = written.str.lower().isin(NOTHING)
        text = ~good & ~empty
        figures = written.where(good).astype(float)  # infinite where a figure is too large to be held
    factor, offset = to_si(column.unit) if column.unit else (1.0, 0.0)
    values = factor * figures + offset
    dimension = next((name for name, units in SUFFIXES.items() if column.unit in units), "")
    large = pd.Series(beyond(values.where(~empty, 0.0).to_numpy(), dimension), cells.index)
    problems = [Problem(_no_number(cells[text], column, layout), path, int(cells.index[text][0]))] if text.any() else []
    problems += at_lines(large, path, f"{column}: {beyond_words(dimension)}")
    return Values(values.where(~(empty | large)), empty, problems)


def at_lines(bad: pd.Series, path: Path, message: str) -> list[Problem]:
    """One problem a line for the first few bad cells, and one that counts the rest."""
    return at_rows(bad.to_numpy(dtype=bool), pd.DataFrame({"line": bad.index}), path, message)


def beyond(values: np.ndarray, dimension: str) -> np.ndarray:
    """Which values [SI] are larger than anything in a wrong unit could be, shape as values."""
    return np.abs(values) > WRONG_UNIT * LARGEST[dimension]


def beyond_words(dimension: str) -> str:
    """Say what is the largest value that is read."""
    si = f" {SUFFIXES[dimension][0]}" if dimension else ""
    return f"expected at most {WRONG_UNIT * LARGEST[dimension]:g}{si}"


def _no_number(wrong: pd.Series, column: ReadColumn, layout: Layout) -> str:
    """Say that cells hold no number."""
    first, more = shortened(str(wrong.iloc[0])), len(wrong) - 1
    other = "," if layout.decimal == "." else "."
    hint = f" (written with '{other}'? say decimal = \"{other}\" in the study)" if other in first else ""
    count = f" (and {more} more rows)" if more else ""
    return f"{column}: expected a number, found '{first}'{hint}{count}"


def _label(cells: pd.Series) -> pd.Series:
    return changed(_text(cells), unquoted)


def _text(cells: pd.Series) -> pd.Series:
    return cells.where(cells.notna(), "").astype(str)


@dataclass(frozen=True)
class Rows:
    """A table in SI units, what was assumed of it, the time_s [s] from which its time counts, and the units it named."""

    table: pd.DataFrame
    notes: tuple[str, ...]
    time_origin: float | None
    units: tuple[str, ...] = ()


def read_rows(
    path: Path, robot: Robot, layout: Layout, conditions_only: bool = False, time_origin: float | None = None
) -> Rows:
    """Read and check a measurement file.

    Args:
        path: a CSV, or a MATLAB file whose arrays become columns `name_1`, `name_2`, …
        robot: says which joints, payloads and markers there are.
        layout: how the file is written.
        conditions_only: the rows are to be predicted, so x, y and z are not needed.
        time_origin: the time_s [s] from which time counts; that of the earliest row where it is None.

    Raises:
        InputError: with everything that is wrong in the file.
    """
    cells = read_cells(path, layout)
    columns = columns_read(list(map(str, cells)), layout, robot, path)
    problems = [Problem(told, path, 1) for told in check_header(columns, layout, robot, conditions_only)]
    known = column_names(robot, layout.reports)
    read = {
        column: values_of(cells[column.theirs], column, layout, path) for column in columns if _is_told(column, known)
    }
    gone = _without_measurement(read, layout)
    wrong = [
        problem for column, own in read.items() for problem in (*_empty(column, own, gone, layout, path), *own.problems)
    ]
    if problems:
        raise InputError(problems + wrong)
    table, following = filled(_assembled(read, gone, layout), robot, path)
    table, notes = labelled(table if layout.reports.measured else _to_come(table, robot), robot)
    problems = wrong + following + check_values(table, robot, path)
    if problems:
        raise InputError(problems)
    to_come = conditions_only or not layout.reports.measured
    rows = placed_in_time(table, robot, layout, to_come, time_origin)
    table, left_out = kept(rows.table, layout, path)
    return Rows(table, (*notes, *rows.notes, *left_out), rows.time_origin, tuple(sorted({c.unit for c in read})))


def placed_in_time(
    table: pd.DataFrame, robot: Robot, layout: Layout, conditions_only: bool, time_origin: float | None
) -> Rows:
    """Add what follows from when and where a row was measured: time from the origin, order, range, approach and travel."""
    if "time" in table:
        time_origin = float(table["time"].min()) if time_origin is None else time_origin
        table = table.assign(time=table["time"] - time_origin)
    else:
        time_origin = None
    if conditions_only:
        return Rows(table, (), time_origin)
    table, notes = ordered(ranged(table, robot, layout.tracker), robot, layout.in_order)
    return Rows(table, tuple(notes), time_origin)


def _is_told(column: ReadColumn, known: dict[str, str]) -> bool:
    """Whether a column's values can be read: it has a name that is known and a unit of its dimension."""
    return column.name in known and column.unit in SUFFIXES.get(known[column.name], ("",))


def _without_measurement(read: dict[ReadColumn, Values], layout: Layout) -> dict[str, pd.Series]:
    """Return for each marker ('' where markers have no columns of their own) which lines are left out for want of values."""
    gone = {}
    for marker in dict.fromkeys([column.marker for column in read if column.marker] or [""]):
        own = [
            values.empty
            for column, values in read.items()
            if column.name in layout.reports.values and column.marker in ("", marker)
        ]
        if not own:
            gone[marker] = pd.Series(dtype=bool)
            continue
        empty = pd.concat(own, axis=1)
        left_out = {"whole": empty.all(axis=1), "skip": empty.any(axis=1)}
        gone[marker] = left_out.get(layout.missing, pd.Series(False, empty.index))
    return gone


def _empty(column: ReadColumn, own: Values, gone: dict[str, pd.Series], layout: Layout, path: Path) -> list[Problem]:
    """Find empty cells, besides those of the device in rows that are left out."""
    empty = own.empty
    if column.name in (*layout.reports.values, *SIGMAS):
        left_out = [lines for marker, lines in gone.items() if column.marker in ("", marker)]
        empty = empty & ~pd.concat(left_out, axis=1).all(axis=1).reindex(empty.index, fill_value=False)
    return at_lines(empty, path, f"{column} is empty or not a number; complete the row or leave it out")


def _assembled(read: dict[ReadColumn, Values], gone: dict[str, pd.Series], layout: Layout) -> pd.DataFrame:
    """Return a row for each line, and for each marker where they are measured side by side."""
    blocks = []
    for marker, lines in gone.items():
        own = {column.name: values.values for column, values in read.items() if column.marker in ("", marker)}
        block = pd.DataFrame({"line": next(iter(own.values())).index, **{k: v.to_numpy() for k, v in own.items()}})
        if marker:
            block["marker"] = marker
        for name, value in (("sigma", layout.sigma), ("sigma_rotation", layout.sigma_rotation)):
            if value is not None:
                block[name] = value
        blocks.append(block.assign(missing=lines.reindex(block["line"], fill_value=False).to_numpy()))
    return pd.concat(blocks).sort_values("line", kind="stable").reset_index(drop=True)


def kept(table: pd.DataFrame, layout: Layout, path: Path | None) -> tuple[pd.DataFrame, list[str]]:
    """Leave out the rows without measured values (a column `missing` says which), and say how many and which they are.

    They count in the order of measuring, since the robot was there.
    """
    missing = table["missing"].to_numpy()
    table = table.drop(columns="missing")
    if missing.all():
        raise InputError([Problem(f"{EMPTY}; no row has a measured value", path)])
    if not missing.any():
        return table, []
    lines = list(dict.fromkeys(table["line"][missing]))
    named = ", ".join(map(str, lines[:MAX_ROWS_TOLD]))
    more = f" and {len(lines) - MAX_ROWS_TOLD} more" if len(lines) > MAX_ROWS_TOLD else ""
    asked = 'missing = "skip": ' if layout.missing == "skip" else ""
    said = f"{asked}{missing.sum()} of {len(missing)} rows have no measured value and are left out (line {named}{more})"
    return table[~missing].reset_index(drop=True), [said]


def _to_come(table: pd.DataFrame, robot: Robot) -> pd.DataFrame:
    """Return rows at which nothing was measured yet, each a pose of its own where it has no name, with readings or nan."""
    readings = {name: np.nan for name in numbered("q", robot.n_joints) if name not in table}
    poses = {} if "pose" in table else {"pose": np.arange(1, len(table) + 1)}
    return table.assign(**readings, **poses)


CONDITIONS = ("approach", "travel", "wrench", "torque", "time", "temperature")
SIZES = ("sigma", "sigma_rotation")


def rows_of(
    robot: Robot, q: ArrayLike, position: ArrayLike | None, layout: Layout, time_origin: float | None,
    more: Mapping[str, ArrayLike],
) -> Rows:  # fmt: skip
    """Return the table of arrays in SI units (see `Measurements.from_arrays`); rows count from 1.

    Raises:
        InputError: with everything that is wrong in the arrays.
    """
    given = {"q": q, "position": position, **more}
    known = ("q", "position", "rotation", *LABELS, *SIZES, *CONDITIONS)
    problems = [Problem(f"unknown array{nearest(name, known)}", key=name) for name in more if name not in known]
    n_rows = len(np.atleast_1d(np.asarray(q)))
    columns: dict[str, object] = {"line": np.arange(1, n_rows + 1)}
    for name, values in given.items():
        if values is None or name not in known:
            continue
        try:
            columns |= _labels(name, values, n_rows) if name in LABELS else _numbers(name, values, n_rows, robot)
        except ValueError as error:
            problems.append(Problem(str(error), key=name))
    if problems:
        raise InputError(problems)
    table = pd.DataFrame(columns)
    measured = [name for name in (*POSITION, *ANGLES) if name in table]
    gone = table[measured].isna().all(axis=1) if measured else pd.Series(False, table.index)
    gone &= not gone.all()  # nothing at all is no gap
    problems = _not_finite(table, robot, gone)
    if problems:
        raise InputError(problems)
    table, following = filled(table, robot, None)
    table, notes = labelled(table, robot)
    problems = following + check_values(table, robot, None)
    if problems:
        raise InputError(problems)
    rows = placed_in_time(table.assign(missing=gone), robot, layout, position is None, time_origin)
    table, left_out = kept(rows.table, layout, None)
    return Rows(table, (*notes, *rows.notes, *left_out), rows.time_origin)


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
        from scipy.spatial.transform import Rotation

        array, names = angles(Rotation.from_matrix(array)), [*ANGLES]
    else:
        names = {"q": condition_columns("reading", robot), "position": [*POSITION]}.get(name) or (
            [name] if name in SIZES else condition_columns(name, robot)
        )
    if array.ndim == 2 and array.shape[1] == len(robot.driven) < robot.n_joints and len(names) == robot.n_joints:
        names = [names[i] for i in robot.driven]
    wide = (n_rows, len(names))
    if array.ndim < 2 and len(names) == 1:
        array = np.broadcast_to(array.reshape(-1, 1) if array.ndim else array, wide)
    if array.shape != wide:
        raise ValueError(f"expected shape {wide if len(names) > 1 else (n_rows,)}, found {array.shape}")
    return dict(zip(names, array.T, strict=True))


def _not_finite(table: pd.DataFrame, robot: Robot, gone: pd.Series) -> list[Problem]:
    """Find what is no number, besides the device's values in rows (n_rows,) where nothing was measured."""
    known = column_names(robot)
    problems: list[Problem] = []
    for name in (name for name in table if name != "line" and name not in LABELS):
        values = table[name].to_numpy(dtype=float)
        excused = gone.to_numpy() if name in (*POSITION, *ANGLES, *SIGMAS) else False
        problems += at_rows(~np.isfinite(values) & ~np.array(excused), table, None, f"{name}: expected a finite number")
        large = beyond(np.where(np.isfinite(values), values, 0.0), known[str(name)])
        problems += at_rows(large, table, None, f"{name}: {beyond_words(known[str(name)])}")
    return problems
