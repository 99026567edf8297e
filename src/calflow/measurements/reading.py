"""The measurement file: a CSV, or a foreign file through a mapping, read into a checked table."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.files.problems import InputError, Problem, nearest, refuse
from calflow.files.units import to_si
from calflow.measurements.checks import at_rows, check_header, check_loop, check_units, check_values, mapped
from calflow.measurements.measurements import Measurements, MeasurementSource, column_names, numbered, split_column
from calflow.robot.robot import Robot

NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"


def read_measurements(
    path: Path, robot: Robot, source: MeasurementSource | None = None, conditions_only: bool = False
) -> Measurements:
    """Read and check a measurement file.

    Args:
        path: a CSV, or a MATLAB file whose arrays become columns `name_1`, `name_2`, …
        robot: says which joints, payloads and markers there are.
        source: how to read a foreign file.
        conditions_only: the rows are to be predicted, so x, y and z are not needed.

    Raises:
        InputError: with everything that is wrong in the file.
    """
    source = source or MeasurementSource(file=str(path))
    native = _named_natively(_read_table(path, source), source, path)
    columns: dict[str, tuple[str, str]] = {}
    for spelled in map(str, native):
        name, unit = split_column(spelled, robot)
        columns.setdefault(name, (spelled, unit))
    problems = check_header(list(map(str, native)), columns, source, robot, path, conditions_only)
    table, wrong = _to_si(native, columns, source, robot, path)
    if problems:
        raise InputError(problems + wrong)
    for name, value in (("sigma", source.sigma), ("sigma_rotation", source.sigma_rotation)):
        if value is not None:
            table[name] = value
    table, notes = _label(table, robot)
    problems = wrong + check_values(table, robot, path)
    if problems:
        raise InputError(problems)
    table, more = _placed_in_time(table, robot, source, conditions_only)
    measured = Measurements(robot, table, (*notes, *more))
    named = {unit for _, unit in columns.values()}
    problems = check_units(measured, named, path, conditions_only) or check_loop(measured, path)
    if problems:
        raise InputError(problems)
    return measured


def locate(source: MeasurementSource, folder: Path) -> Path:
    """Return the path of the measurement file: CALFLOW_DATA, then the study's folder, then fetched by its url.

    Raises:
        InputError: it is nowhere, or its SHA-256 differs from the study's.
    """
    data = os.environ.get("CALFLOW_DATA")
    places = [Path(data) / source.file] if data else []
    path = next((place for place in [*places, folder / source.file] if place.is_file()), None)
    if path is None and source.url:
        path = _fetch(source)
    if path is None:
        raise refuse(
            "no such measurement file; expected it there, in the folder that CALFLOW_DATA names, or by a url in the study",
            folder / source.file,
        )
    if not os.access(path, os.R_OK):
        raise refuse("cannot be read: permission denied", path)
    if source.sha256 and sha256(path) != source.sha256:
        raise refuse(f"wrong SHA-256: the study names {source.sha256}, the file has {sha256(path)}", path)
    return path


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _fetch(source: MeasurementSource) -> Path:
    import pooch

    try:
        return Path(pooch.retrieve(source.url, f"sha256:{source.sha256}", path=pooch.os_cache("calflow")))
    except Exception as error:  # any network fault: requests' many classes are pooch's, not ours
        if "hash" in str(error):
            raise refuse(f"wrong SHA-256: {error}", key=source.url) from None
        raise refuse(
            f"could not be fetched ({error}); put the file into the folder that CALFLOW_DATA names, as {source.file}",
            key=source.url,
        ) from None


def _read_table(path: Path, source: MeasurementSource) -> pd.DataFrame:
    """Return the file's cells as text (numbers of a MATLAB file as they are), indexed by line; empty lines are left out."""
    empty = "is empty: expected a header line and a row per measured point"
    try:
        if path.suffix.lower() == ".mat":
            return _read_mat(path, source)
        with path.open("rb") as stream:
            if b"\0" in stream.read(4096):
                raise refuse("is not a text file: expected a CSV", path)
        raw = pd.read_csv(path, sep=source.separator, dtype=str, keep_default_na=False, skip_blank_lines=False,
                          encoding="utf-8-sig")  # fmt: skip
    except pd.errors.EmptyDataError:
        raise refuse(empty, path) from None
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be read: {str(error).strip()}", path) from None
    other = next((sign for sign in ";\t|," if sign in str(raw.columns[0])), None)
    if len(raw.columns) == 1 and other:
        raise refuse(f"has no {source.separator!r} in its header line, but {other!r}: say separator = {json.dumps(other)} "
                     "in the study's [measurements] (and decimal = \",\" where numbers have a decimal comma)", path, 1)  # fmt: skip
    if not isinstance(raw.index, pd.RangeIndex):
        raise refuse(f"has more values in a row than the {len(raw.columns)} names of the header line", path, 2)
    raw = raw.fillna("").apply(lambda column: column.str.strip())
    raw.index = pd.RangeIndex(2, len(raw) + 2)
    raw = raw[(raw != "").any(axis=1)]
    if raw.empty:
        raise refuse(empty, path)
    return raw


def _read_mat(path: Path, source: MeasurementSource) -> pd.DataFrame:
    """Return the arrays that the study's mapping names (all where it names none), a column for each of their columns."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        arrays = {name: np.asarray(value) for name, value in loadmat(path).items() if not name.startswith("__")}
    except (MatReadError, NotImplementedError, TypeError, KeyError) as error:
        raise ValueError(error) from None
    named = {theirs.rpartition("_")[0] for theirs in mapped(source)} or set(arrays)
    wide = {name: array.reshape(len(array), -1) for name, array in arrays.items() if name in named and array.ndim}
    table = pd.DataFrame({f"{name}_{j + 1}": a[:, j] for name, a in wide.items() for j in range(a.shape[1])})
    return table.set_axis(pd.RangeIndex(1, len(table) + 1))


def _named_natively(raw: pd.DataFrame, source: MeasurementSource, path: Path) -> pd.DataFrame:
    """Rename a foreign file's columns; markers measured side by side become rows of their own."""
    if not source.columns and not source.markers:
        return raw
    absent = [name for name in mapped(source) if name not in raw]
    if absent:
        raise InputError(
            Problem(f"no column '{name}', which the study's mapping names{nearest(name, raw.columns)}", path, 1)
            for name in absent
        )
    common = pd.DataFrame({ours: raw[theirs] for ours, theirs in source.columns.items()}, index=raw.index)
    if not source.markers:
        return common
    blocks = [
        common.assign(marker=marker, **{ours: raw[theirs] for ours, theirs in columns.items()})
        for marker, columns in source.markers.items()
    ]
    return pd.concat(blocks).sort_index(kind="stable")


def _to_si(
    native: pd.DataFrame, columns: dict[str, tuple[str, str]], source: MeasurementSource, robot: Robot, path: Path
) -> tuple[pd.DataFrame, list[Problem]]:
    """Return the known columns in SI units and what is wrong in their cells; a wrong cell becomes nan."""
    table = pd.DataFrame({"line": native.index}, index=native.index)
    problems: list[Problem] = []
    known = column_names(robot)
    for name, (spelled, unit) in columns.items():
        cells = native[spelled]
        if name in ("marker", "payload", "session", "split"):
            table[name] = _text(cells)
        elif name in ("pose", "repeat"):
            table[name] = _text(cells).str.replace(r"\.0*$", "", regex=True)
            problems += at_rows(table[name] == "", table, path, f"column '{spelled}' is empty")
            if table[name].str.fullmatch(r"\d{1,18}").all():
                table[name] = table[name].astype(int)
        elif name in known:
            numbers, wrong = _numbers(cells, spelled, source, path)
            factor, offset = to_si(unit) if unit else (1.0, 0.0)
            table[name] = factor * numbers + offset
            problems += wrong
    return table.reset_index(drop=True), problems


def _text(cells: pd.Series) -> pd.Series:
    return cells.where(cells.notna(), "").astype(str)


def _numbers(cells: pd.Series, spelled: str, source: MeasurementSource, path: Path) -> tuple[pd.Series, list[Problem]]:
    if pd.api.types.is_numeric_dtype(cells):
        numbers, text = cells.astype(float), pd.Series(False, cells.index)
    else:
        written = _text(cells)
        if source.decimal == ",":
            written = written.str.replace(".", "?", regex=False).str.replace(",", ".", regex=False)
        good = written.str.fullmatch(NUMBER)
        text = ~good & ~written.str.lower().isin(
            ["", "nan", "-nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none"]
        )
        numbers = written.where(good).astype(float)
    empty = pd.DataFrame({"line": cells.index[~text & ~np.isfinite(numbers)]})
    problems = at_rows(np.full(len(empty), True), empty, path,
                     f"column '{spelled}' is empty or not a number; complete the row or leave it out")  # fmt: skip
    if text.any():
        first, more = cells[text].iloc[0], int(text.sum()) - 1
        other = "," if source.decimal == "." else "."
        hint = f" (written with '{other}'? say decimal = \"{other}\" in the study)" if other in str(first) else ""
        count = f" (and {more} more rows)" if more else ""
        problems.append(Problem(f"column '{spelled}': expected a number, found '{first}'{hint}{count}", path,
                                int(cells.index[text][0])))  # fmt: skip
    return numbers, problems


def _placed_in_time(
    table: pd.DataFrame, robot: Robot, source: MeasurementSource, conditions_only: bool
) -> tuple[pd.DataFrame, list[str]]:
    """Add what follows from when and where a row was measured: time from the first, order, range, approach and travel."""
    table = table.copy()
    if "time" in table:
        table["time"] -= table["time"].min()
    if conditions_only:
        return table, []
    table["order"] = table["time"].rank(method="dense") if "time" in table else np.arange(1.0, len(table) + 1)
    at_origin = robot.base.known and not np.any(robot.base.origin)
    if source.tracker is not None or not at_origin:
        table["range"] = np.linalg.norm(table[["x", "y", "z"]] - np.array(source.tracker or (0.0, 0.0, 0.0)), axis=1)
    if not source.in_order or "approach1" in table:
        return table, []
    came, far = approach_and_travel(table, numbered("q", robot.n_joints))
    table[numbered("approach", robot.n_joints)] = came
    table[numbered("travel", robot.n_joints)] = far
    return table, ["in_order = true: approach directions and travel follow from the order of the rows"]


def approach_and_travel(table: pd.DataFrame, readings: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return each row's approach directions and its travel since the joints last turned back, (n_rows, n_joints) each."""
    q = table.sort_values("order", kind="stable")[readings].to_numpy()
    came, far = np.zeros_like(q), np.zeros_like(q)
    for k in range(1, len(q)):
        step = q[k] - q[k - 1]
        same = (np.sign(step) == came[k - 1]) | (step == 0)
        came[k] = np.where(step == 0, came[k - 1], np.sign(step))
        far[k] = np.where(same, far[k - 1], 0.0) + np.abs(step)
    back = np.argsort(np.argsort(table["order"].to_numpy(), kind="stable"), kind="stable")
    return came[back], far[back]


def _label(table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, list[str]]:
    """Fill in the labels that may be left out: marker, payload, pose and repeat."""
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
