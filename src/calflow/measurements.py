"""What was measured: a CSV (or a foreign file through a mapping) as one checked table in SI units."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field, field_validator, model_validator

from calflow.conditions import OPTIONAL, Row
from calflow.problems import InputError, Problem, nearest, refuse
from calflow.robot.description import Robot
from calflow.toml_file import Angle, FileModel, Length
from calflow.units import SUFFIXES, split_unit, to_si

LABELS = ("pose", "repeat", "marker", "payload", "split")
MAX_ROWS_TOLD = 5  # a message names this many rows of a kind, then counts the rest
MEASURED = ("x", "y", "z", "rx", "ry", "rz", "qw", "qx", "qy", "qz")
NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
SHAPE_ROWS = 200  # rows whose distances from each other tell a wrong unit,
SHAPE_WRONG, SHAPE_RIGHT = (
    0.3,
    0.1,
)  # where they disagree by more than the first, and in that unit by less than the second


class MeasurementSource(FileModel):
    """Where the measurements are and how to read them: the `[measurements]` table of a study.

    A url is fetched once and kept; its sha256 is then required. The folder that CALFLOW_DATA names is looked in first.
    columns maps calflow's names to a foreign file's; markers does so for files with several markers side by side.
    """

    file: str
    url: str | None = None
    sha256: str | None = None
    separator: str = ","
    decimal: Literal[".", ","] = "."
    columns: dict[str, str] = {}
    markers: dict[str, dict[str, str]] = {}
    sigma: Length | None = Field(default=None, gt=0)
    sigma_rotation: Angle | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _fetched_is_checked(self) -> MeasurementSource:
        if self.url and not self.sha256:
            raise ValueError("a url needs the file's sha256")
        if self.separator == self.decimal:
            raise ValueError(
                f"separator and decimal are both {self.decimal!r}; columns are usually separated by ';' then"
            )
        return self

    @field_validator("separator")
    @classmethod
    def _is_one_character(cls, separator: str) -> str:
        if len(separator) != 1:
            raise ValueError(f"expected one character, found {separator!r}")
        return separator

    @field_validator("sha256")
    @classmethod
    def _is_a_hash(cls, sha256: str | None) -> str | None:
        if sha256 and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ValueError(f"expected 64 digits 0-9 and a-f, found {len(sha256)} characters: {sha256!r}")
        return sha256


@dataclass(frozen=True)
class Measurements:
    """Checked rows in SI units: columns pose, repeat, marker, payload, split, line, q1 …, x, y, z and optional ones."""

    robot: Robot
    table: pd.DataFrame
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.table)

    @property
    def joints(self) -> np.ndarray:
        """Joint readings, shape (n_rows, n_joints) [rad, or m]."""
        return self.table[_numbered("q", self.robot.n_joints)].to_numpy()

    @property
    def position(self) -> np.ndarray:
        """Measured positions, shape (n_rows, 3) [m]."""
        return self.table[["x", "y", "z"]].to_numpy()

    @property
    def rotation(self) -> np.ndarray | None:
        """Measured rotations, shape (n_rows, 3, 3), or None where only positions were measured."""
        from scipy.spatial.transform import Rotation

        if "rx" in self.table:
            return Rotation.from_euler("XYZ", self.table[["rx", "ry", "rz"]].to_numpy()).as_matrix()
        if "qw" in self.table:
            return Rotation.from_quat(self.table[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()
        return None

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each row's position, per axis, shape (n_rows,) [m], or None where it is not known."""
        return self.table["sigma"].to_numpy() if "sigma" in self.table else None

    @property
    def train(self) -> np.ndarray:
        """Which rows may be fitted, shape (n_rows,)."""
        return (self.table["split"] == "train").to_numpy()

    @property
    def given(self) -> tuple[str, ...]:
        """The optional conditions that the rows have."""
        first = {
            "approach": "approach1",
            "wrench": "fx",
            "torque": "tau1",
            "time": "time",
            "temperature": "temperature",
        }
        return tuple(name for name in OPTIONAL if first[name] in self.table)

    @cached_property
    def rows(self) -> np.ndarray:
        """Packed conditions, shape (n_conditions, n_rows), as `conditions.Row` orders them."""
        n = self.robot.n_joints
        columns = {
            "reading": _numbered("q", n),
            "approach": _numbered("approach", n),
            "wrench": ["fx", "fy", "fz", "mx", "my", "mz"],
            "torque": _numbered("tau", n),
            "time": ["time"],
            "temperature": ["temperature"],
        }
        parts = []
        for name in Row.sizes(self.robot, self.given):
            if name == "payload":
                parts += [self.table["payload"] == known for known in self.robot.payloads]
            elif name == "marker":
                parts += [self.table["marker"] == known for known in self.robot.markers]
            else:
                parts += [self.table[column] for column in columns[name]]
        return np.array([part.to_numpy(dtype=float) for part in parts])

    def only(self, mask: np.ndarray) -> Measurements:
        """Return the rows where mask is true."""
        return Measurements(self.robot, self.table[mask].reset_index(drop=True), self.notes)

    def on(self, robot: Robot) -> Measurements:
        """Return the same rows for a robot that differs in its dimensions only (a registered base, say)."""
        return Measurements(robot, self.table, self.notes)


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
        name, unit = _split_column(spelled, robot)
        columns.setdefault(name, (spelled, unit))
    problems = _check_header(list(map(str, native)), columns, source, robot, path, conditions_only)
    table, wrong = _to_si(native, columns, source, robot, path)
    if problems:
        raise InputError(problems + wrong)
    for name, value in (("sigma", source.sigma), ("sigma_rotation", source.sigma_rotation)):
        if value is not None:
            table[name] = value
    table, notes = _label(table, robot)
    problems = wrong + _check_values(table, robot, path)
    if problems:
        raise InputError(problems)
    measured = Measurements(robot, table, tuple(notes))
    named = {unit for _, unit in columns.values()}
    problems = _check_units(measured, named, path, conditions_only) or _check_loop(measured, path)
    if problems:
        raise InputError(problems)
    return measured


def draw_split(measured: Measurements, holdout: float, seed: int) -> Measurements:
    """Return the rows with a split drawn by pose, each payload in proportion; an explicit split stays."""
    if "split" in measured.table:
        return measured
    rng = np.random.default_rng(seed)
    table = measured.table.copy()
    table["split"] = "train"
    carried = table.groupby("pose")["payload"].agg(lambda payloads: "\n".join(sorted(set(payloads))))
    for _, group in carried.groupby(carried, sort=True):
        poses = np.sort(group.index)
        held = rng.permutation(poses)[: round(holdout * len(poses))]
        table.loc[table["pose"].isin(held), "split"] = "holdout"
    return Measurements(measured.robot, table, measured.notes)


def column_names(robot: Robot) -> dict[str, str]:
    """Return every column a measurement file may have, without its unit, and the column's dimension ('' for none)."""
    n = robot.n_joints
    names = dict.fromkeys((*LABELS, "qw", "qx", "qy", "qz", *_numbered("approach", n)), "")
    names |= {f"q{i + 1}": "angle" if joint.kind == "revolute" else "length" for i, joint in enumerate(robot.joints)}
    names |= dict.fromkeys(("x", "y", "z", "sigma"), "length")
    names |= dict.fromkeys(("nominal_x", "nominal_y", "nominal_z"), "length")  # of select/poses.csv, filled in
    names |= dict.fromkeys(("rx", "ry", "rz", "sigma_rotation"), "angle")
    names |= dict.fromkeys(("fx", "fy", "fz"), "force") | dict.fromkeys(("mx", "my", "mz"), "moment")
    names |= dict.fromkeys(_numbered("tau", n), "moment")
    return names | {"time": "time", "temperature": "temperature"}


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
    named = {theirs.rpartition("_")[0] for theirs in _mapped(source)} or set(arrays)
    wide = {name: array.reshape(len(array), -1) for name, array in arrays.items() if name in named and array.ndim}
    table = pd.DataFrame({f"{name}_{j + 1}": a[:, j] for name, a in wide.items() for j in range(a.shape[1])})
    return table.set_axis(pd.RangeIndex(1, len(table) + 1))


def _mapped(source: MeasurementSource) -> list[str]:
    """The foreign file's columns that the study's mapping names."""
    return [*source.columns.values(), *(name for marker in source.markers.values() for name in marker.values())]


def _named_natively(raw: pd.DataFrame, source: MeasurementSource, path: Path) -> pd.DataFrame:
    """Rename a foreign file's columns; markers measured side by side become rows of their own."""
    if not source.columns and not source.markers:
        return raw
    absent = [name for name in _mapped(source) if name not in raw]
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


def _split_column(spelled: str, robot: Robot) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit."""
    return (spelled, "") if column_names(robot).get(spelled) == "" else split_unit(spelled) or (spelled, "")


def _to_si(
    native: pd.DataFrame, columns: dict[str, tuple[str, str]], source: MeasurementSource, robot: Robot, path: Path
) -> tuple[pd.DataFrame, list[Problem]]:
    """Return the known columns in SI units and what is wrong in their cells; a wrong cell becomes nan."""
    table = pd.DataFrame({"line": native.index}, index=native.index)
    problems: list[Problem] = []
    known = column_names(robot)
    for name, (spelled, unit) in columns.items():
        cells = native[spelled]
        if name in ("marker", "payload", "split"):
            table[name] = _text(cells)
        elif name in ("pose", "repeat"):
            table[name] = _text(cells).str.replace(r"\.0*$", "", regex=True)
            problems += _rows(table[name] == "", table, path, f"column '{spelled}' is empty")
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
    problems = _rows(np.full(len(empty), True), empty, path,
                     f"column '{spelled}' is empty or not a number; complete the row or leave it out")  # fmt: skip
    if text.any():
        first, more = cells[text].iloc[0], int(text.sum()) - 1
        other = "," if source.decimal == "." else "."
        hint = f" (written with '{other}'? say decimal = \"{other}\" in the study)" if other in str(first) else ""
        count = f" (and {more} more rows)" if more else ""
        problems.append(Problem(f"column '{spelled}': expected a number, found '{first}'{hint}{count}", path,
                                int(cells.index[text][0])))  # fmt: skip
    return numbers, problems


def _check_header(
    spelled: list[str], columns: dict[str, tuple[str, str]], source: MeasurementSource, robot: Robot, path: Path,
    conditions_only: bool,
) -> list[Problem]:  # fmt: skip
    known, problems = column_names(robot), []

    def tell(message: str) -> None:
        problems.append(Problem(message, path, 1))

    for column in spelled:
        name, unit = _split_column(column, robot)
        if columns[name][0] != column:
            tell(f"column '{column}': '{name}' is there twice, in different units")
        elif name not in known or (unit and not known[name]):
            every = [f"{n}_{s}" if s else n for n, d in known.items() for s in SUFFIXES.get(d, ("",))]
            tell(f"unknown column '{column}'{nearest(column, every)}")
        elif known[name] and unit not in SUFFIXES[known[name]]:
            wanted = ", ".join(f"{name}_{suffix}" for suffix in SUFFIXES[known[name]])
            tell(f"column '{column}' needs a unit of {known[name]} in its name: {wanted}")
        elif conditions_only and name in MEASURED:
            tell(f"column '{column}' is what will be predicted: leave it out of the rows")
    for name in _required(columns, robot, conditions_only):
        if name not in columns:
            wanted = " or ".join(f"{name}_{s}" if s else name for s in SUFFIXES.get(known[name], ("",)))
            tell(f"missing column: expected {wanted}")
    for name, stated in (("sigma", source.sigma), ("sigma_rotation", source.sigma_rotation)):
        if stated is not None and name in columns:
            tell(f"column '{columns[name][0]}': the study's [measurements] states {name} too; expected one of them")
    oriented = "rx" in columns or "qw" in columns
    if oriented and not conditions_only and robot.tool_rotation is None:
        tell("has measured orientations, but the robot file does not say how the tool is turned: expected "
             "tool_rotation_deg = [rx, ry, rz] there")  # fmt: skip
    if oriented and not conditions_only and source.sigma_rotation is None and "sigma_rotation" not in columns:
        tell("has measured orientations, but not how sure they are: expected a column sigma_rotation_mrad, or "
             "sigma_rotation_mrad = … in the study's [measurements]")  # fmt: skip
    if "rx" in columns and "qw" in columns:
        tell("has orientations twice, as rx, ry, rz and as a quaternion: expected one of them")
    return problems


def _required(columns: dict[str, tuple[str, str]], robot: Robot, conditions_only: bool) -> list[str]:
    required = _numbered("q", robot.n_joints) + ([] if conditions_only else ["x", "y", "z"])
    if len(robot.markers) > 1:
        required.append("marker")
    groups = (_numbered("approach", robot.n_joints), _numbered("tau", robot.n_joints), ["fx", "fy", "fz", "mx", "my", "mz"],
              ["rx", "ry", "rz"], ["qw", "qx", "qy", "qz"])  # fmt: skip
    return required + [name for group in groups if any(n in columns for n in group) for name in group]


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
        keys = [*_numbered("q", robot.n_joints), "payload"]
        table["pose"] = table.groupby(keys, sort=False, dropna=False).ngroup() + 1
        notes.append(
            f"no column 'pose': rows with equal joint readings and payload count as one pose ({table['pose'].nunique()})"
        )
    if "repeat" not in table:
        table["repeat"] = table.groupby(["pose", "marker"]).cumcount() + 1
    return table, notes


def _check_values(table: pd.DataFrame, robot: Robot, path: Path) -> list[Problem]:
    problems: list[Problem] = []
    for name, known, optional in (("marker", robot.markers, False), ("payload", robot.payloads, True)):
        for value in table[name].unique():
            if value not in known and not (optional and value == ""):
                names = ", ".join(known) or "none"
                problems += _rows(table[name] == value, table, path,
                                  f"unknown {name} '{value}'; the robot file has {names}{nearest(value, known)}")  # fmt: skip
    for i in range(robot.n_joints):
        if f"approach{i + 1}" in table:
            wrong = ~table[f"approach{i + 1}"].isin([-1, 0, 1, np.nan])
            problems += _rows(wrong, table, path, f"approach{i + 1}: expected -1, 0 or 1")
    for name in ("sigma", "sigma_rotation"):
        if name in table:
            problems += _rows(table[name] <= 0, table, path, f"{name}: expected a positive standard deviation")
    if "qw" in table:
        norm = np.linalg.norm(table[["qw", "qx", "qy", "qz"]], axis=1)
        problems += _rows(np.abs(norm - 1) > 0.01, table, path, "qw, qx, qy, qz: expected a quaternion of norm 1")
    if "split" in table:
        split = table["split"].where(table["split"].isin(["train", "holdout"]))
        problems += _rows(split.isna(), table, path, "split: expected 'train' or 'holdout'")
        mixed = split.groupby(table["pose"]).transform("nunique") > 1
        problems += _rows(mixed, table, path, "split: one pose is in train and in holdout; held out is a whole pose")
    twice = table.duplicated(["pose", "repeat", "marker"], keep="first") & (table["pose"] != "")
    problems += _rows(twice, table, path, "duplicate pose: the same pose, repeat and marker stand in an earlier row")
    joints = table[_numbered("q", robot.n_joints)]
    moved = (joints - joints.groupby(table["pose"]).transform("first")).abs().max(axis=1) > 0.02
    problems += _rows(
        moved & ~twice,
        table,
        path,
        "duplicate pose: this pose number has other joint readings in an earlier row",
    )
    return problems


def _check_units(measured: Measurements, named: set[str], path: Path, conditions_only: bool) -> list[Problem]:
    """Find degrees called radians, millimetres called metres and the like, by what the robot can do.

    Distances between the measured points are compared with those of the nominal robot's: if they agree far better when
    angles or lengths are read in another unit than the one named, that is the unit they are in.
    """
    revolute = [i for i, joint in enumerate(measured.robot.joints) if joint.kind == "revolute"]
    largest = np.abs(measured.joints[:, revolute]).max() if revolute else 0.0
    angles = f"q1 … q{measured.robot.n_joints}"
    degrees = f"{angles}: does a column named _rad hold degrees? "
    if largest > 6 * np.pi:
        return [Problem(f"{degrees}The largest reading is {largest:.4g} rad, over three turns", path)]
    if conditions_only or measured.table["pose"].nunique() <= 3:
        return []
    turns, stretches = {1.0: ""}, {1.0: ""}
    if "rad" in named:
        turns[np.pi / 180] = degrees
    if "deg" in named:
        turns[180 / np.pi] = f"{angles}: does a column named _deg hold radians? "
    if "m" in named:
        stretches[1e-3] = "x, y, z: does a column named _m hold millimetres? "
    if "mm" in named:
        stretches[1e3] = "x, y, z: does a column named _mm hold metres? "
    found = {(turn, stretch): _disagreement(measured, turn, stretch) for turn in turns for stretch in stretches}
    as_named, best = found[1.0, 1.0], min(found, key=lambda units: found[units])
    if as_named < SHAPE_WRONG or found[best] > SHAPE_RIGHT:
        return []
    return [
        Problem(
            f"{turns[best[0]]}{stretches[best[1]]}The measured points would fit the nominal robot far better then", path
        )
    ]


def _disagreement(measured: Measurements, turn: float, stretch: float) -> float:
    """How far distances between points differ from the nominal robot's: 0 where all agree, at most 1.

    Readings of revolute joints are multiplied by turn, measured positions by stretch.
    """
    from calflow.model import build

    nominal = build(measured.robot, (), measured.given)
    chosen = np.unique(np.linspace(0, len(measured) - 1, SHAPE_ROWS).astype(int))
    rows = measured.rows[:, chosen]
    rows[: measured.robot.n_joints] *= [[turn if joint.kind == "revolute" else 1.0] for joint in measured.robot.joints]
    both = (stretch * measured.position[chosen], nominal.position(nominal.nominal, rows))
    points, expected = (np.linalg.norm(places[:, None] - places[None], axis=2) for places in both)
    share = np.median(np.abs(points - expected)) / (np.median(points) + np.median(expected))
    return float(share) if np.isfinite(share) else 1.0


def _check_loop(measured: Measurements, path: Path) -> list[Problem]:
    if measured.robot.loop is None:
        return []
    from calflow.model import build

    nominal = build(measured.robot, (), measured.given)
    open_ = np.abs(nominal.closure_cosine(nominal.nominal, measured.rows)) >= 1
    return _rows(open_, measured.table, path, "the four-bar loop cannot be closed at these joint readings")


def _rows(bad: Any, table: pd.DataFrame, path: Path, message: str) -> list[Problem]:
    """One problem a row for the first few bad rows, and one that counts the rest."""
    lines = table["line"].to_numpy()[np.asarray(bad, dtype=bool)]
    problems = [Problem(message, path, int(line)) for line in lines[:MAX_ROWS_TOLD]]
    if len(lines) > MAX_ROWS_TOLD:
        problems.append(Problem(f"{message} (and {len(lines) - MAX_ROWS_TOLD} more rows)", path))
    return problems


def _numbered(stem: str, n: int) -> list[str]:
    return [f"{stem}{i + 1}" for i in range(n)]


def known_columns(robot: Robot) -> Iterable[str]:
    """Return every column name with its SI unit, for help texts."""
    return [f"{name}_{SUFFIXES[d][0]}" if d else name for name, d in column_names(robot).items()]
