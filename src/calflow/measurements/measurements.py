"""Measurements of a robot: one checked table in SI units.

The rows of several devices (series) form one table; a session is a block of rows measured with an unchanged setup.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from html import escape
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from calflow.files.deferred import Rotation, pd
from calflow.files.problems import refuse
from calflow.files.toml import Seed, checked_arguments
from calflow.files.words import plural
from calflow.measurements.rows import (
    ANGLES,
    POSITION,
    QUATERNION,
    TARGETS,
    Layout,
    Rows,
    blocks_of,
    condition_columns,
    numbered,
    read_rows,
    rows_of,
)
from calflow.measurements.series import Series
from calflow.robot.mechanism import NUMBERED, OPTIONAL, Row, name_number
from calflow.robot.robot import Robot

SPREAD = 0.2  # K: standard deviation below which temperatures count as constant
DERIVED = ("order", "range", "session", "image_row", *NUMBERED)  # that a series may lack, or that are recomputed
PAUSE, GAPS_OF_PAUSE = 900.0, 10.0  # s and median times between rows: one longer than both is a pause
SAME_READINGS = 0.02  # rad or m: largest difference between joint readings of one pose


@dataclass(frozen=True, eq=False, repr=False)
class Measurements:
    """Checked rows in SI units: pose, repeat, marker, payload, split, line, order, q1 …, x, y, z and optional columns.

    split is train, holdout, or "" for rows that belong to neither. The column time is relative to time_origin, a value
    of the file's time_s [s]; None if there are no times. units are those stated in the file's column names. payload_stated
    is false of rows that do not say what is carried, and count as carrying nothing.
    """

    robot: Robot
    table: pd.DataFrame
    notes: tuple[str, ...] = ()
    series: tuple[Series, ...] = (Series(),)
    time_origin: float | None = None
    units: tuple[str, ...] = ()
    payload_stated: bool = True

    @classmethod
    @checked_arguments
    def from_csv(cls, path: str | Path, robot: Robot, **how: Any) -> Measurements:
        """Read a CSV, or a MATLAB file whose arrays become columns `name_1`, `name_2`, …

        Args:
            path: the file.
            robot: defines the joints, payloads and markers.
            how: fields of `Layout` that differ from their defaults.

        Raises:
            InputError: with everything that is wrong in the file.
        """
        return cls._of(robot, read_rows(Path(path), robot, _layout(how)))

    @classmethod
    def to_predict(cls, path: str | Path, robot: Robot, time_origin: float | None = None, **how: Any) -> Measurements:
        """Read rows at which the robot is to be predicted, without measured values; times are since time_origin [s].

        Raises:
            InputError: with everything that is wrong in the file.
        """
        return cls._of(robot, read_rows(Path(path), robot, _layout(how), True, time_origin))

    @classmethod
    def to_reach(cls, path: str | Path, robot: Robot, time_origin: float | None = None, **how: Any) -> Measurements:
        """Read target poses of a tool: x, y, z, optionally its orientation, and optionally joint readings.

        Raises:
            InputError: with everything that is wrong in the file.
        """
        layout = _layout({**how, "missing": "refuse", "reports": TARGETS})
        return cls._of(robot, read_rows(Path(path), robot, layout, time_origin=time_origin))

    @classmethod
    @checked_arguments
    def from_arrays(
        cls,
        robot: Robot,
        q: ArrayLike,
        position: ArrayLike | None,
        *,
        in_order: bool = False,
        tracker: tuple[float, float, float] | None = None,
        time_origin: float | None = None,
        **more: ArrayLike,
    ) -> Measurements:
        """Build measurements from arrays in SI units.

        Args:
            robot: defines the joints, payloads and markers.
            q: joint readings, shape (n_rows, n_joints) [rad, or m].
            position: measured positions, shape (n_rows, 3) [m]; rows of nan were not measured and are left out; None
                for rows to be predicted.
            in_order: whether rows are in measuring order, so that approach and travel follow from the preceding rows.
            tracker: position of the device in the measuring frame [m], if not its origin.
            time_origin: reference of the times [s]; None: the earliest row's time.
            more: further columns, (n_rows, …) or one value for all: pose, repeat, marker, payload, session, split
                (names or whole numbers); rotation (3, 3); sigma [m], sigma_rotation [rad]; approach (n_joints) of -1,
                0, 1; travel (n_joints) [rad, or m]; wrench (6) [N, Nm]; torque (n_joints) [Nm]; time [s]; temperature
                [K]; speed (n_joints) [rad/s, or m/s]; acceleration (n_joints) [rad/s², or m/s²].

        Raises:
            InputError: with everything that is wrong in the arrays.
        """
        layout = Layout(in_order=in_order, tracker=tracker)
        return cls._of(robot, rows_of(robot, q, position, layout, time_origin, more))

    @classmethod
    def _of(cls, robot: Robot, rows: Rows) -> Measurements:
        return numbering_images(cls(robot, **vars(rows)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Measurements):
            return NotImplemented
        mine, others = ((m.robot, m.notes, m.series, m.time_origin) for m in (self, other))
        return mine == others and self.table.equals(other.table)

    __hash__ = None  # type: ignore[assignment]  # a table is not hashable

    def __repr__(self) -> str:
        return f"Measurements({', '.join(f'{name}: {words}' for name, words in self._words().items())})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(words)}</td></tr>" for name, words in self._words().items()
        )
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.notes)
        return f"<table><caption>Measurements</caption>{rows}</table>" + (f"<ul>{notes}</ul>" if notes else "")

    def _words(self) -> dict[str, str]:
        """Return the captions and texts of the summary that a notebook shows."""
        poses = str(self.table["pose"].nunique()) if "pose" in self.table else "unknown"
        words = {"rows": str(len(self)), "poses": poses}
        for name in ("marker", "payload"):
            if name in self.table:
                words[f"{name}s"] = ", ".join(str(value) or "none" for value in self.table[name].unique())
        words["given"] = ", ".join(self.given) or "nothing optional"
        if "split" in self.table:
            words["split"] = f"{plural(int(self.train.sum()), 'row')} to fit, {self.held_out.sum()} held out"
        return words

    def __len__(self) -> int:
        return len(self.table)

    @property
    def payloads(self) -> tuple[str, ...]:
        """The payloads carried, in order of appearance."""
        return tuple(str(name) for name in self.table["payload"].unique() if name)

    @property
    def joints(self) -> np.ndarray:
        """Joint readings, shape (n_rows, n_joints) [rad, or m]."""
        return self.table[numbered("q", self.robot.n_joints)].to_numpy()

    @property
    def joint_angles(self) -> np.ndarray:
        """Joint variables: readings after signs and couplings, shape (n_rows, n_joints) [rad, or m]."""
        return np.asarray(self.joints @ self.robot.reading_matrix.T)

    @property
    def position(self) -> np.ndarray:
        """Measured positions, shape (n_rows, 3) [m]."""
        return self.table[[*POSITION]].to_numpy()

    @property
    def has_positions(self) -> bool:
        """Whether a position was measured in every row."""
        return POSITION[0] in self.table and bool(np.isfinite(self.position).all())

    @property
    def rotation(self) -> np.ndarray | None:
        """Measured rotation matrices, shape (n_rows, 3, 3); None if only positions were measured."""
        return rotations(self.table) if {"rx", "qw"} & set(self.table) else None

    @property
    def session(self) -> np.ndarray:
        """Name of each row's session, shape (n_rows,); empty where rows name none."""
        return self.labels("session")

    def labels(self, column: str) -> np.ndarray:
        """Return each row's label in a column, as session or marker, shape (n_rows,); empty where rows have none."""
        return np.full(len(self), "") if column not in self.table else self.table[column].astype(str).to_numpy(str)

    @property
    def series_number(self) -> np.ndarray:
        """Index of each row's series, counted from 0, shape (n_rows,)."""
        return self.table["series"].to_numpy() if "series" in self.table else np.zeros(len(self), dtype=int)

    def of_series(self, k: int) -> np.ndarray:
        """Return the mask of the rows of a series (counted from 0), shape (n_rows,)."""
        return self.series_number == k

    @property
    def devices(self) -> tuple[str, ...]:
        """Names of the devices, in order of the series."""
        return tuple(dict.fromkeys(series.device for series in self.series))

    @property
    def device(self) -> np.ndarray:
        """Name of each row's device, shape (n_rows,)."""
        return np.array([series.device for series in self.series], dtype=object)[self.series_number]

    def imaged(self, label: str) -> np.ndarray:
        """Name of each row's camera, or target, (n_rows,): its label, after its device where there are several."""
        names = self.table[label].astype(str) if label in self.table else pd.Series("", self.table.index)
        devices = self.device if len(self.series) > 1 else np.full(len(self), "")
        return np.array([" ".join(filter(None, pair)) for pair in zip(devices, names, strict=True)], dtype=object)

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each row's position, per axis, shape (n_rows,) [m]; None if unknown."""
        return self.table["sigma"].to_numpy() if "sigma" in self.table else None

    @property
    def repeats(self) -> np.ndarray:
        """Number of measurements that each row is the mean of, shape (n_rows,)."""
        return self.table["of_repeats"].to_numpy() if "of_repeats" in self.table else np.ones(len(self))

    @cached_property
    def repeated(self) -> np.ndarray:
        """Repeat group (n_rows,) of each row: its series, session, pose, marker, payload, touch, approach and wrench."""
        within = dict.fromkeys(name for series in self.series for name in series.within)
        return self._grouped([*self._of_standstill, "marker", *(name for name in within if name in self.table)])

    @cached_property
    def standstill(self) -> np.ndarray:
        """Number (n_rows,) of the standstill at which each row was measured; markers and repeats may share one."""
        return np.arange(len(self)) if self.table["pose"].is_unique else self._grouped(self._of_standstill)

    @property
    def _of_standstill(self) -> list[str]:
        given = [condition for condition in ("approach", "wrench") if condition in self.given]
        columns = [name for condition in given for name in condition_columns(condition, self.robot)]
        labels = [name for series in self.series for name in series.labels]
        there = [name for name in dict.fromkeys(["series", "session", *labels]) if name in self.table]
        return ["pose", "payload", *columns, *there]

    def _grouped(self, columns: list[str]) -> np.ndarray:
        """Return numbers (n_rows,), the same for rows that are alike in some columns, in the order of their first rows."""
        return np.asarray(self.table.groupby(columns, sort=False, dropna=False).ngroup())

    @property
    def train(self) -> np.ndarray:
        """Mask of the training rows, shape (n_rows,)."""
        return (self.table["split"] == "train").to_numpy()

    @property
    def held_out(self) -> np.ndarray:
        """Mask of the held-out rows, shape (n_rows,)."""
        return (self.table["split"] == "holdout").to_numpy()

    @property
    def in_images(self) -> bool:
        """Whether every row is an image point."""
        return "u" in self.table and bool(self.table["u"].notna().all())

    @property
    def temperature_changes(self) -> bool:
        """Whether the measured temperature varies by more than `SPREAD`."""
        return "temperature" in self.given and float(self.table["temperature"].std()) > SPREAD

    @property
    def given(self) -> tuple[str, ...]:
        """The optional conditions that the rows have."""
        return tuple(name for name in OPTIONAL if condition_columns(name, self.robot)[0] in self.table)

    @cached_property
    def conditions(self) -> np.ndarray:
        """Conditions of all rows as one array, shape (n_conditions, n_rows), in the order of `mechanism.Row`."""
        parts = []
        for name in Row.sizes(self.robot, self.given):
            if name == "payload":
                parts += [self.table["payload"] == name for name in self.robot.payloads]
            elif name == "marker":
                parts += [self.table["marker"] == name for name in self.robot.markers]
            elif name == "session":
                parts.append(self.table["session"].astype(str).map(name_number))
            else:
                parts += [self.table[column] for column in condition_columns(name, self.robot)]
        return np.array([part.to_numpy(dtype=float) for part in parts])

    def only(self, mask: np.ndarray) -> Measurements:
        """Return the rows where mask is true."""
        return self if mask.all() else replace(self, table=self.table[mask].reset_index(drop=True))

    def stating(self, conditions: Collection[str]) -> Measurements:
        """Return the rows without the optional conditions that are not among these."""
        others = [name for name in self.given if name not in conditions]
        left_out = [column for name in others for column in condition_columns(name, self.robot)]
        return replace(self, table=self.table.drop(columns=left_out))

    def on(self, robot: Robot) -> Measurements:
        """Return the same rows for a robot with other dimensions (with a registered base, say)."""
        return replace(self, robot=robot)

    @checked_arguments
    def split(self, holdout: Annotated[float, Field(ge=0, lt=1)] = 0.3, seed: Seed = 1) -> Measurements:
        """Return the rows with a random split by pose, stratified by payload and session; an explicit split stays.

        Args:
            holdout: share of held-out poses.
            seed: seed of the draw.
        """
        if "split" in self.table:
            return self
        rng = np.random.default_rng(seed)
        table = self.table.assign(split="train")
        names = [table[name] for name in blocks_of(table)] or [pd.Series("", table.index)]
        every = reduce(lambda first, further: first + "\n" + further, names)
        block = every.groupby(table["pose"]).agg(lambda names: "\n".join(sorted(set(names))))
        for _, group in block.groupby(block, sort=True):
            poses = np.sort(group.index)
            held = rng.permutation(poses)[: round(holdout * len(poses))]
            table.loc[table["pose"].isin(held), "split"] = "holdout"
        return replace(self, table=table)


def _layout(how: Mapping[str, Any]) -> Layout:
    """Return the layout with these fields; raises InputError if it is invalid."""
    try:
        return Layout(**how)
    except ValueError as error:
        raise refuse(str(error)) from None


def spaced(values: np.ndarray, most: int) -> np.ndarray:
    """Return at most so many of values (n,), evenly spaced."""
    return values[np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))]


def image_numbers(table: pd.DataFrame) -> np.ndarray:
    """Return the number of each row's image, from 0 in order of appearance, (n_rows,)."""
    keys = [name for name in ("pose", "repeat", "camera", "target") if name in table]
    return table.groupby(keys, sort=False).ngroup().to_numpy()


def rotations(table: pd.DataFrame) -> np.ndarray:
    """Return rotation matrices (n_rows, 3, 3) of intrinsic x-y-z angles or quaternions, nan where none was measured."""

    angles = "rx" in table
    stated = table[[*ANGLES] if angles else [*QUATERNION[1:], QUATERNION[0]]].to_numpy(float)
    there = np.isfinite(stated).all(axis=1)
    matrices = np.full((len(table), 3, 3), np.nan)
    if there.any():
        turned = Rotation.from_euler("XYZ", stated[there]) if angles else Rotation.from_quat(stated[there])
        matrices[there] = turned.as_matrix()
    return matrices


def combined(parts: Sequence[Measurements]) -> Measurements:
    """Return the concatenated rows of several series of one robot, each part being one series.

    A pose name shared by several parts means the same pose if the joint readings agree. Conditions that not all parts
    state are left out, with a note.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    origins = [part.time_origin for part in parts if part.time_origin is not None]
    origin = min(origins) if len(origins) == len(parts) else None
    shared = [name for name in OPTIONAL if all(name in part.given for part in parts)]
    split = any("split" in part.table for part in parts)
    tables = [_rows_of_series(k, part.stating((*shared, *DERIVED)), origin, split) for k, part in enumerate(parts)]
    whole = pd.concat(_with_unique_names(tables, numbered("q", first.robot.n_joints)), ignore_index=True)
    labels = {name for part in parts for name in part.series[0].labels}
    for label in {"session", *labels, *whole.select_dtypes(["object", "string"])}:
        if label in whole:
            whole[label] = whole[label].fillna("")
    whole["order"] = whole["time"].rank(method="dense") if origin is not None else np.arange(1.0, len(whole) + 1)
    # A series of points beside one of full poses has columns of orientations too, all empty: its kind is told here.
    series = tuple(replace(part.series[0], kind=part.series[0].kind_in(part.table)) for part in parts)
    made = replace(
        first, table=whole, notes=tuple(dict.fromkeys(_notes(parts, shared, split))), time_origin=origin,
        series=series, units=tuple(sorted({unit for part in parts for unit in part.units})),
        payload_stated=any(part.payload_stated for part in parts),
    )  # fmt: skip
    return numbering_images(made)


def numbering_images(data: Measurements) -> Measurements:
    """Return the rows with the numbers of camera and target where all are of images, and where in an image the arm moves."""
    names = {number: data.imaged(label) for number, label in NUMBERED.items()} if data.in_images else {}
    numbers: dict[str, Any] = {number: [*map(name_number, each)] for number, each in names.items()}
    if data.in_images and "speed" in data.given:
        numbers["image_row"] = data.table["v"]
    return replace(data, table=data.table.drop(columns=[*NUMBERED, "image_row"], errors="ignore").assign(**numbers))


def _notes(parts: Sequence[Measurements], shared: Sequence[str], split: bool) -> Iterator[str]:
    """Yield the notes of all parts, and those on conditions and a split that not all of them state."""
    named = [(part.series[0].name or k + 1, part) for k, part in enumerate(parts)]
    yield from (f"{name}: {note}" for name, part in named for note in part.notes)
    for part in parts:
        if lost := [name for name in part.given if name not in (*shared, *DERIVED)]:
            yield f"not all measurements state {', '.join(lost)}: left out"
    for name, part in named:
        if split and "split" not in part.table:
            yield f"{name}: no column 'split', as others have: all rows are to be fitted"


def _rows_of_series(k: int, part: Measurements, origin: float | None, split: bool) -> pd.DataFrame:
    """Return the rows of series k, times from a common origin [s], to be fitted where they have no split and others do."""
    rows = part.table.assign(series=k, pose=part.table["pose"].astype(str), repeat=part.table["repeat"].astype(str))
    if origin is not None and part.time_origin is not None:
        rows["time"] += part.time_origin - origin
    return rows.assign(split="train") if split and "split" not in rows else rows


def continued(parts: Sequence[Measurements]) -> Measurements:
    """Return the rows of several files of one series as if they stood in one file."""
    if len(parts) == 1:
        return parts[0]
    whole = combined(parts)
    return numbering_images(replace(whole, table=whole.table.drop(columns="series"), series=parts[0].series))


def _with_unique_names(tables: Sequence[pd.DataFrame], readings: list[str]) -> list[pd.DataFrame]:
    """Return the tables with poses renamed where equal names have different readings, so that a name means one pose."""
    named: list[pd.DataFrame] = []
    for k, table in enumerate(tables):
        for other in named:
            both = table.drop_duplicates("pose").merge(
                other.drop_duplicates("pose"), on="pose", suffixes=("", "_other")
            )
            difference = np.abs(both[readings].to_numpy() - both[[f"{name}_other" for name in readings]].to_numpy())
            if (difference > SAME_READINGS).any():
                table = table.assign(pose=[f"{k + 1}:{pose}" for pose in table["pose"]])
                table = table.assign(pose=_matched_names(table, named, readings))
                break
        named.append(table)
    return named


def _matched_names(table: pd.DataFrame, others: Sequence[pd.DataFrame], readings: list[str]) -> list[str]:
    """Return the pose names of a table, taken from other tables where these have identical readings and payload."""
    keys = [*readings, "payload"]
    poses = {tuple(row[:-1]): row[-1] for other in others for row in other[[*keys, "pose"]].to_numpy(dtype=object)}
    return [poses.get(tuple(row[:-1]), row[-1]) for row in table[[*keys, "pose"]].to_numpy(dtype=object)]


def sessions_of(data: Measurements) -> tuple[str, ...]:
    """Return the names of the sessions in measuring order; empty if rows name none."""
    if "session" not in data.table:
        return ()
    table = data.table.sort_values("order", kind="stable") if "order" in data.table else data.table
    return tuple(dict.fromkeys(table["session"].astype(str)))


def borders(data: Measurements) -> np.ndarray:
    """Return the values of `order` midway between consecutive sessions; empty if sessions overlap."""
    sessions = sessions_of(data)
    if len(sessions) < 2 or "order" not in data.table:
        return np.array([])
    spans = data.table.groupby(data.session)["order"].agg(["min", "max"]).loc[list(sessions)]
    last, first = spans["max"].to_numpy(float)[:-1], spans["min"].to_numpy(float)[1:]
    return (last + first) / 2 if (last < first).all() else np.array([])


def pauses(data: Measurements) -> tuple[tuple[float, float], ...]:
    """Return the pauses in measuring, each as the times [s] of the row before and after it; none without times."""
    every = np.unique(data.table["time"].to_numpy(float)) if "time" in data.given else np.zeros(0)
    gaps = np.diff(every)
    if not len(gaps):
        return ()
    paused = np.flatnonzero(gaps > max(PAUSE, GAPS_OF_PAUSE * np.median(gaps)))
    return tuple((float(every[k]), float(every[k + 1])) for k in paused)
