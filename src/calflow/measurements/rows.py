"""The rows of a measurement file: its cells as one checked table in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.files.problems import InputError, Problem
from calflow.files.units import SUFFIXES
from calflow.measurements.cells import EMPTY, read_cells
from calflow.measurements.checks import MAX_ROWS_TOLD, check_header, check_values
from calflow.measurements.columns import SIGMAS, column_names, numbered
from calflow.measurements.followers import filled
from calflow.measurements.header import ReadColumn, columns_read
from calflow.measurements.labels import labelled
from calflow.measurements.layout import Layout
from calflow.measurements.sequence import ordered, ranged
from calflow.measurements.values import Values, at_lines, values_of
from calflow.robot.robot import Robot


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
