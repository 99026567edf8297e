"""What was measured: a CSV (or a foreign file through a mapping) as one checked table in SI units."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from calflow.conditions import OPTIONAL, Row
from calflow.problems import InputError, Problem, nearest, refuse
from calflow.robot.description import Robot
from calflow.toml_file import Angle, FileModel, Length
from calflow.units import SUFFIXES, split_unit, to_si

LABELS = ("pose", "repeat", "marker", "payload", "split")
MAX_ROWS_TOLD = 5  # a message names this many rows of a kind, then counts the rest


class MeasurementSource(FileModel):
    """Where the measurements are and how to read them: the `[measurements]` table of a study.

    A url is fetched once and kept; its sha256 is then required. The folder that CALFLOW_DATA names is looked in first.
    columns maps calflow's names to a foreign file's; markers does so for files with several markers side by side.
    """

    file: str
    url: str | None = None
    sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
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
        return self


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
    path = next((place for place in [*places, folder / source.file] if place.exists()), None)
    if path is None and source.url:
        path = _fetch(source)
    if path is None:
        raise refuse(
            "no such measurement file; expected it there, in the folder that CALFLOW_DATA names, or by a url in the study",
            folder / source.file,
        )
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
    raw = _read_table(path, source)
    if raw.empty:
        raise refuse("is empty: expected a header line and a row per measured point", path)
    native = _named_natively(raw, source, path)
    table, problems = _to_si(native, path)
    problems += _missing(table, robot, path, conditions_only)
    if problems:
        raise InputError(problems)
    for name, value in (("sigma", source.sigma), ("sigma_rotation", source.sigma_rotation)):
        if value is not None and name not in table:
            table[name] = value
    table, notes = _label(table, robot)
    problems = _check_values(table, robot, path, conditions_only)
    if problems:
        raise InputError(problems)
    measured = Measurements(robot, table, tuple(notes))
    if not conditions_only:
        problems = _check_units(measured, path)
    problems += _check_loop(measured, path)
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
    for _, rows in table.groupby("payload", sort=True, dropna=False):
        poses = np.sort(rows["pose"].unique())
        held = rng.permutation(poses)[: round(holdout * len(poses))]
        table.loc[table["pose"].isin(held), "split"] = "holdout"
    return Measurements(measured.robot, table, measured.notes)


def column_names(robot: Robot) -> dict[str, str]:
    """Return every column a measurement file may have, without its unit, and the column's dimension ('' for none)."""
    n = robot.n_joints
    names = dict.fromkeys((*LABELS, "qw", "qx", "qy", "qz", *_numbered("approach", n)), "")
    names |= {f"q{i + 1}": "angle" if joint.kind == "revolute" else "length" for i, joint in enumerate(robot.joints)}
    names |= dict.fromkeys(("x", "y", "z", "sigma"), "length")
    names |= dict.fromkeys(("rx", "ry", "rz", "sigma_rotation"), "angle")
    names |= dict.fromkeys(("fx", "fy", "fz"), "force") | dict.fromkeys(("mx", "my", "mz"), "moment")
    names |= dict.fromkeys(_numbered("tau", n), "moment")
    return names | {"time": "time", "temperature": "temperature"}


def _fetch(source: MeasurementSource) -> Path:
    import pooch

    try:
        return Path(pooch.retrieve(source.url, f"sha256:{source.sha256}", path=pooch.os_cache("calflow")))
    except ValueError as error:  # what pooch raises for a wrong hash
        raise refuse(f"wrong SHA-256: {error}", key=source.url) from None
    except Exception as error:  # any network fault: requests' many classes are pooch's, not ours
        raise refuse(
            f"could not be fetched ({error}); put the file into the folder that CALFLOW_DATA names, as {source.file}",
            key=source.url,
        ) from None


def _read_table(path: Path, source: MeasurementSource) -> pd.DataFrame:
    try:
        if path.suffix == ".mat":
            return _read_mat(path)
        if path.stat().st_size == 0:
            return pd.DataFrame()
        return pd.read_csv(path, sep=source.separator, decimal=source.decimal, float_precision="round_trip")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise refuse(f"cannot be read: {error}", path) from None


def _read_mat(path: Path) -> pd.DataFrame:
    from scipy.io import loadmat

    arrays = {name: value for name, value in loadmat(path).items() if not name.startswith("__")}
    return pd.DataFrame({f"{name}_{j + 1}": a[:, j] for name, a in arrays.items() for j in range(a.shape[1])})


def _named_natively(raw: pd.DataFrame, source: MeasurementSource, path: Path) -> pd.DataFrame:
    """Rename a foreign file's columns; markers measured side by side become rows of their own."""
    raw = raw.assign(line=np.arange(2, len(raw) + 2))
    if not source.columns and not source.markers:
        return raw
    wanted = [
        *source.columns.values(),
        *(name for marker in source.markers.values() for name in marker.values()),
    ]
    absent = [name for name in wanted if name not in raw]
    if absent:
        raise InputError(
            Problem(f"no column '{name}', which the study's mapping names{nearest(name, raw.columns)}", path, 1)
            for name in absent
        )
    common = pd.DataFrame({ours: raw[theirs] for ours, theirs in {**source.columns, "line": "line"}.items()})
    if not source.markers:
        return common
    blocks = [
        common.assign(marker=marker, row=np.arange(len(raw)), **{ours: raw[theirs] for ours, theirs in columns.items()})
        for marker, columns in source.markers.items()
    ]
    return pd.concat(blocks).sort_values("row", kind="stable").drop(columns="row").reset_index(drop=True)


def _to_si(native: pd.DataFrame, path: Path) -> tuple[pd.DataFrame, list[Problem]]:
    table: dict[str, Any] = {}
    problems: list[Problem] = []
    for column in native.columns:
        name, unit = split_unit(str(column)) or (str(column), "")
        if name in table:
            problems.append(Problem(f"column '{column}': '{name}' is there twice, in different units", path, 1))
        values = native[column]
        if name in LABELS[2:]:
            table[name] = values.where(values.notna(), "").astype(str)
        elif unit and not pd.api.types.is_numeric_dtype(values):
            bad = pd.to_numeric(values, errors="coerce").isna() & values.notna()
            problems.append(
                Problem(f"column '{column}': expected numbers, found '{values[bad].iloc[0]}' (a decimal comma? "
                        "say decimal = \",\" in the study)", path, int(native["line"][bad].iloc[0]))
            )  # fmt: skip
        else:
            factor, offset = to_si(unit) if unit else (1.0, 0.0)
            table[name] = values * factor + offset if unit else values
        if unit:
            table.setdefault("_units", {})[name] = unit
    units = table.pop("_units", {})
    frame = pd.DataFrame(table)
    frame.attrs["units"] = units
    return frame, problems


def _missing(table: pd.DataFrame, robot: Robot, path: Path, conditions_only: bool) -> list[Problem]:
    known = column_names(robot)
    units: dict[str, str] = table.attrs["units"]
    problems = []
    for name in table.columns:
        column = f"{name}_{units[name]}" if name in units else name
        if name == "line":
            continue
        if name not in known:
            spelled = [f"{n}_{s}" for n, d in known.items() if d for s in SUFFIXES[d]] + [
                n for n, d in known.items() if not d
            ]
            problems.append(Problem(f"unknown column '{column}'{nearest(column, spelled)}", path, 1))
        elif known[name] and units.get(name) not in SUFFIXES[known[name]]:
            wanted = ", ".join(f"{name}_{suffix}" for suffix in SUFFIXES[known[name]])
            problems.append(Problem(f"column '{column}' needs a unit of {known[name]} in its name: {wanted}", path, 1))
    required = _numbered("q", robot.n_joints) + ([] if conditions_only else ["x", "y", "z"])
    if len(robot.markers) > 1:
        required.append("marker")
    groups = (_numbered("approach", robot.n_joints), _numbered("tau", robot.n_joints), ["fx", "fy", "fz", "mx", "my", "mz"],
              ["rx", "ry", "rz"], ["qw", "qx", "qy", "qz"])  # fmt: skip
    required += [name for group in groups if any(n in table for n in group) for name in group]
    if ("rx" in table or "qw" in table) and robot.tool_rotation is None:
        problems.append(
            Problem("has measured orientations, but the robot file does not say how the tool is turned: expected "
                    "tool_rotation_deg = [rx, ry, rz] there", path, 1)
        )  # fmt: skip
    for name in required:
        if name not in table:
            suffixes = SUFFIXES[known[name]] if known[name] else ("",)
            wanted = " or ".join(f"{name}_{s}" if s else name for s in suffixes)
            problems.append(Problem(f"missing column: expected {wanted}", path, 1))
    return problems


def _label(table: pd.DataFrame, robot: Robot) -> tuple[pd.DataFrame, list[str]]:
    """Fill in the labels that may be left out: marker, payload, pose and repeat."""
    table = table.copy()
    notes = []
    if "marker" not in table:
        table["marker"] = next(iter(robot.markers))
    if "payload" not in table:
        table["payload"] = ""
    if "pose" not in table:
        keys = [*_numbered("q", robot.n_joints), "payload"]
        table["pose"] = table.groupby(keys, sort=False, dropna=False).ngroup() + 1
        notes.append(
            f"no column 'pose': rows with equal joint readings and payload count as one pose ({table['pose'].nunique()})"
        )
    if "repeat" not in table:
        table["repeat"] = table.groupby(["pose", "marker"]).cumcount() + 1
    return table, notes


def _check_values(table: pd.DataFrame, robot: Robot, path: Path, conditions_only: bool) -> list[Problem]:
    problems: list[Problem] = []
    for name in table.columns:
        if pd.api.types.is_numeric_dtype(table[name]):
            bad = ~np.isfinite(table[name].to_numpy(dtype=float))
            problems += _rows(
                bad,
                table,
                path,
                f"column '{name}' is empty or not a number; complete the row or leave it out",
            )
    if problems:
        return problems
    for name, known, optional in (("marker", robot.markers, False), ("payload", robot.payloads, True)):
        for value in table[name].unique():
            if value not in known and not (optional and value == ""):
                names = ", ".join(known) or "none"
                problems += _rows(table[name] == value, table, path,
                                  f"unknown {name} '{value}'; the robot file has {names}{nearest(value, known)}")  # fmt: skip
    for i in range(robot.n_joints):
        if f"approach{i + 1}" in table:
            problems += _rows(
                ~table[f"approach{i + 1}"].isin([-1, 0, 1]),
                table,
                path,
                f"approach{i + 1}: expected -1, 0 or 1",
            )
    if "sigma" in table:
        problems += _rows(table["sigma"] <= 0, table, path, "sigma: expected a positive standard deviation")
    if "split" in table:
        problems += _rows(
            ~table["split"].isin(["train", "holdout"]), table, path, "split: expected 'train' or 'holdout'"
        )
        mixed = table.groupby("pose")["split"].transform("nunique") > 1
        problems += _rows(mixed, table, path, "split: one pose is in train and in holdout; held out is a whole pose")
    twice = table.duplicated(["pose", "repeat", "marker"], keep="first")
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


def _check_units(measured: Measurements, path: Path) -> list[Problem]:
    """Find degrees called radians, and millimetres called metres, by comparing with what the robot can do."""
    robot, table = measured.robot, measured.table
    problems = []
    revolute = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    largest = np.abs(measured.joints[:, revolute]).max() if revolute else 0.0
    columns = f"q1 … q{robot.n_joints}"
    if largest > 6 * np.pi:
        problems.append(Problem(f"{columns}: the largest reading is {largest:.4g} rad, over three turns: does a column named "
                                "_rad hold degrees?", path))  # fmt: skip
    elif (
        revolute
        and measured.table["pose"].nunique() > 3
        and np.ptp(measured.joints[:, revolute], axis=0).max() < np.deg2rad(7)
    ):
        problems.append(Problem(f"{columns}: no joint moves by more than 7 degrees over all poses: does a column named _deg "
                                "hold radians?", path))  # fmt: skip
    if problems:
        return problems
    from calflow.model import build

    nominal = build(robot, (), measured.given)
    spread = np.linalg.norm(measured.position - measured.position.mean(axis=0), axis=1).mean()
    predicted = nominal.position(nominal.nominal, measured.rows)
    expected = np.linalg.norm(predicted - predicted.mean(axis=0), axis=1).mean()
    if table["pose"].nunique() > 3 and expected > 0 and not 0.02 < spread / expected < 50:
        problems.append(Problem(f"x, y, z: the points spread over {1e3 * spread:.4g} mm, the nominal robot at these joint readings "
                                f"over {1e3 * expected:.4g} mm: is the unit in the columns' names right?", path))  # fmt: skip
    return problems


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
