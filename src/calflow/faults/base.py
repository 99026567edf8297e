"""Faults of the data: their description, their corrections, and the application of these in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.files.words import first_up
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import IN_ORDER, approach_and_travel, numbered
from calflow.observations.base import observation_kinds

Action = Literal["corrected", "left out", "told", "unsettled"]
MEASUREMENT_FILE, ROBOT_FILE, SET_UP = "measurement file", "robot file", "set-up"
ROBOT = "robot"  # of a cause, not a mistake
AXES = ("x", "y", "z")
POSITION = "position"  # the quantity x, y, z
MISNAMED = "name-mistyped"  # the fault that rows bear another object's name, or payload's
EXCHANGED = {"x and y": ("x", "y"), "x and z": ("x", "z"), "y and z": ("y", "z")}  # exchanged axes
DEVICE_COLUMNS = (*AXES, "rx", "ry", "rz", "qw", "qx", "qy", "qz", "sigma", "sigma_rotation", "range")


@dataclass(frozen=True, kw_only=True)
class FaultyRow:
    """A faulty line or column of the measurement file, and what was done about it."""

    cause: str = column("id of the fault")
    joint: int = column("number of the joint; 0: none")
    line: int | None = column("line of the file; empty: the whole column")
    pose: str = column("as in the measurements", default="")
    action: Action = column(
        "what was done; told: reported only; unsettled: reported only, and no cause is named until the user has settled it"
    )
    statement: str = column("what is wrong, in words")
    where: str = column(
        "location of the mistake: measurement file, robot file or set-up; robot: possibly a cause, not a mistake",
        default=MEASUREMENT_FILE,
    )
    row: int = column("number of the row, from 1; 0: every row")
    quantity: str = column(
        "the corrected quantity: position, a measured one, a name, exchanged axes, or a setting treated as not stated; empty: none",
        default="",
    )
    factor: float = column("factor applied to the quantity", default=1.0)
    offset: float = column("offset added after that", "SI", default=0.0)
    source: int = column("number of the row whose quantity, or measured values, replace its own; 0: none", default=0)

    @property
    def sentences(self) -> str:
        """The statement with its clauses as sentences."""
        first, *others = self.statement.split("; ")
        return " ".join(f"{clause}." for clause in (first, *map(first_up, others)))


@dataclass(frozen=True)
class Correction:
    """A correction of a row: its quantity times factor plus offset (SI), or that of the row source (a name, say).

    Without a quantity, all measured values are those of the source; an excluded row has neither. Rows count from 1, in the
    order of the file; row 0 means every row. The quantity may also be a setting of the series' observation, which is then
    treated as not stated.
    """

    row: int
    quantity: str = ""
    factor: float = 1.0
    offset: float = 0.0
    source: int = 0


@dataclass(frozen=True)
class Fault:
    """A fault: its cause, joint (0: none), lines of the file (none: a whole column), correction, and location.

    If the right value is unknown, the fault is only reported; a fault of the robot file or the whole table is unsettled
    until the user has corrected it, and no cause is named until then.
    """

    cause: str
    joint: int
    lines: tuple[int, ...]
    statement: str
    action: Action
    corrections: tuple[Correction, ...] = ()
    where: str = MEASUREMENT_FILE

    @property
    def summary(self) -> str:
        """Its kind and statement, on one line."""
        return f"{self.cause.replace('-', ' ')}: {self.statement}"

    def in_all_rows(self, rows: np.ndarray) -> Fault:
        """Return a fault found in a subset of the data with row numbers of all data; rows (n,): the subset's, from 0."""

        def moved(row: int) -> int:
            return int(rows[row - 1]) + 1 if row else 0

        corrections = (
            replace(correction, row=moved(correction.row), source=moved(correction.source))
            for correction in self.corrections
        )
        return replace(self, corrections=tuple(corrections))

    def rows(self, data: Measurements) -> list[FaultyRow]:
        """Return its rows of identify/faults.csv: one per faulty row, or a single one for a whole column."""
        at = [max(correction.row, 1) - 1 for correction in self.corrections]
        labels = data.table[["line", "pose"]].iloc[at].astype(object).to_numpy()
        return [
            FaultyRow(
                cause=self.cause, joint=self.joint, line=line if correction.row else None, pose=pose if correction.row else "",
                action=self.action, statement=self.statement, where=self.where, **vars(correction),
            )
            for correction, (line, pose) in zip(self.corrections, labels, strict=True)
        ]  # fmt: skip


def fault(
    cause: str,
    data: Measurements,
    joint: int,
    corrections: Sequence[Correction],
    action: Action,
    statement: str,
    where: str = MEASUREMENT_FILE,
) -> Fault:
    """Return a fault with the lines of its rows; LINES in the statement is replaced by these in words."""
    rows = [correction.row - 1 for correction in corrections if correction.row]
    lines = tuple(dict.fromkeys(int(line) for line in data.table["line"].iloc[rows]))
    return Fault(
        cause, joint, lines, statement.replace("LINES", lines_in_words(lines)), action, tuple(corrections), where
    )


def faulty_rows(
    cause: str, data: Measurements, rows: Sequence[int] | np.ndarray, action: Action, statement: str
) -> Fault:
    """Return a fault of rows (from 0) without a correction, which are left out or only reported (see `fault`)."""
    return fault(cause, data, 0, [Correction(int(row) + 1) for row in rows], action, statement)


def correct(data: Measurements, fault: Fault) -> Measurements:
    """Return the rows with a fault corrected, or with its rows excluded from every split."""
    before, table = data.table, data.table.copy()
    of_series = [correction for correction in fault.corrections if _is_setting(data, correction)]
    data = reduce(_without_setting, of_series, data)
    changing = [made for made in fault.corrections if made not in of_series and (made.quantity or made.source)]
    for quantity, copied in dict.fromkeys((made.quantity, made.source > 0) for made in changing):
        same = [made for made in changing if (made.quantity, made.source > 0) == (quantity, copied)]
        row, source, factor, offset = np.array([(made.row, made.source, made.factor, made.offset) for made in same]).T
        at = row.astype(int) - 1 if row[0] else slice(None)
        quantities = {"": DEVICE_COLUMNS, POSITION: AXES, **EXCHANGED}.get(quantity, (quantity,))
        names = [name for name in quantities if name in table]
        values = table[names].to_numpy(copy=True)
        if copied:
            values[at] = before[names].to_numpy()[source.astype(int) - 1]
        else:
            mended = values[at] * factor[:, None] + offset[:, None]
            values[at] = mended[:, ::-1] if quantity in EXCHANGED else mended
        table[names] = values
    if fault.action == "left out":
        split = table["split"].to_numpy(copy=True)
        split[[correction.row - 1 for correction in fault.corrections]] = ""
        table["split"] = split
    mirrored = any(correction.quantity in (*AXES, *EXCHANGED) for correction in fault.corrections)
    return replace(data, table=_with_derived(table, before, data, mirrored))


def _is_setting(data: Measurements, correction: Correction) -> bool:
    """Return whether a correction concerns a setting that the user stated for a series."""
    kind = observation_kinds().get(data.series[_series(data, correction)].kind)
    return kind is not None and correction.quantity in kind.settings.model_fields


def _series(data: Measurements, correction: Correction) -> int:
    return int(data.series_number[max(correction.row, 1) - 1])


def _without_setting(data: Measurements, correction: Correction) -> Measurements:
    """Return the data without a setting of a series."""
    k = _series(data, correction)
    settings = tuple(setting for setting in data.series[k].settings if setting[0] != correction.quantity)
    return replace(data, series=(*data.series[:k], replace(data.series[k], settings=settings), *data.series[k + 1 :]))


def _with_derived(table: pd.DataFrame, before: pd.DataFrame, data: Measurements, mirrored: bool) -> pd.DataFrame:
    """Return the table with derived quantities updated: approach and travel from readings, range from positions.

    If the frame was mirrored, so was the device, and ranges stay.
    """
    readings, place = numbered("q", data.robot.n_joints), [*AXES]
    if IN_ORDER in data.notes and not table[readings].equals(before[readings]):
        came, far = approach_and_travel(table, readings)
        table[numbered("approach", data.robot.n_joints)] = came
        table[numbered("travel", data.robot.n_joints)] = far
    if "range" not in table or mirrored:
        return table
    moved = (table[place].fillna(0) != before[place].fillna(0)).any(axis=1) & (table["range"] == before["range"])
    if moved.any():  # the device's position follows from the other rows' ranges
        still = ~moved & before["range"].notna()
        x, r = before.loc[still, place].to_numpy(), before.loc[still, "range"].to_numpy()
        equations = np.column_stack([2 * x, np.ones(len(x))])
        device = np.linalg.lstsq(equations, (x**2).sum(axis=1) - r**2, rcond=None)[0][:3]
        table.loc[moved, "range"] = np.linalg.norm(table.loc[moved, place] - device, axis=1)
    return table


def line_in_words(data: Measurements, row: int) -> str:
    """Return the line of a row (from 0) in words, with its image's name if it has one."""
    image = data.table["image"].iloc[row] if "image" in data.table else ""
    return f"line {data.table['line'].iloc[row]}" + f" (image {image})" * bool(image)


def lines_in_words(lines: Sequence[int], most: int = 8) -> str:
    """Return line numbers in words: consecutive ones as ranges, a long list truncated."""
    every = np.unique(lines)
    runs = [run for run in np.split(every, np.flatnonzero(np.diff(every) > 1) + 1) if len(run)]
    words = [" to ".join(map(str, dict.fromkeys((run[0], run[-1])))) for run in runs[:most]]
    more = [f"{len(runs) - most} more places"] if len(runs) > most else []
    return f"{'line' if len(every) == 1 else 'lines'} {', '.join([*words, *more])}"
