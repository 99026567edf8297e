"""Measurements from arrays: the checked table of rows that were never in a file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from calflow.files.problems import InputError, Problem, nearest
from calflow.measurements.checks import at_rows, check_values
from calflow.measurements.columns import ANGLES, LABELS, POSITION, SIGMAS, column_names, condition_columns
from calflow.measurements.followers import filled
from calflow.measurements.labels import labelled
from calflow.measurements.layout import Layout
from calflow.measurements.rows import Rows, kept, placed_in_time
from calflow.measurements.values import beyond, beyond_words
from calflow.robot.angles import angles
from calflow.robot.robot import Robot

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
