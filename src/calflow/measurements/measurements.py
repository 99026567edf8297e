"""What was measured: one checked table in SI units, and where it comes from."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Literal

import numpy as np
import pandas as pd
from pydantic import Field, field_validator, model_validator

from calflow.files.toml import Angle, FileModel, Length, Lengths3
from calflow.files.units import split_unit
from calflow.measurements.series import Series
from calflow.robot.conditions import OPTIONAL, Row
from calflow.robot.robot import Robot

LABELS = ("pose", "repeat", "marker", "payload", "session", "split")
BLOCKS = ("payload", "session")  # what poses are held out, and resampled, within


class MeasurementSource(FileModel):
    """Where the measurements are and how to read them: the `[measurements]` table of a study.

    A url is fetched once and kept; its sha256 is then required. The folder that CALFLOW_DATA names is looked in first.
    columns maps calflow's names to a foreign file's; markers does so for files with several markers side by side.
    in_order says that the rows stand in the order of measuring, so that each pose's approach is known from the one before.
    tracker is where the device stands in the measuring frame, if not at its origin.
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
    in_order: bool = False
    tracker: Lengths3 | None = None

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
    """Checked rows in SI units: columns pose, repeat, marker, payload, split, line, order, q1 …, x, y, z and optional ones.

    split is train, holdout, or "" for rows that are left out of both.
    """

    robot: Robot
    table: pd.DataFrame
    notes: tuple[str, ...] = ()
    series: tuple[Series, ...] = (Series(),)

    def __len__(self) -> int:
        return len(self.table)

    @property
    def joints(self) -> np.ndarray:
        """Joint readings, shape (n_rows, n_joints) [rad, or m]."""
        return self.table[numbered("q", self.robot.n_joints)].to_numpy()

    @property
    def position(self) -> np.ndarray:
        """Measured positions, shape (n_rows, 3) [m]."""
        return self.table[["x", "y", "z"]].to_numpy()

    @property
    def rotation(self) -> np.ndarray | None:
        """Measured rotations, shape (n_rows, 3, 3), or None where only positions were measured."""
        return rotations(self.table) if {"rx", "qw"} & set(self.table) else None

    @property
    def series_number(self) -> np.ndarray:
        """Which series each row is of, counted from 0, shape (n_rows,)."""
        return self.table["series"].to_numpy() if "series" in self.table else np.zeros(len(self), dtype=int)

    def of_series(self, k: int) -> np.ndarray:
        """Which rows are of a series (counted from 0), shape (n_rows,)."""
        return self.series_number == k

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each row's position, per axis, shape (n_rows,) [m], or None where it is not known."""
        return self.table["sigma"].to_numpy() if "sigma" in self.table else None

    @property
    def repeats(self) -> np.ndarray:
        """How many measurements each row is the mean of, shape (n_rows,)."""
        return self.table["of_repeats"].to_numpy() if "of_repeats" in self.table else np.ones(len(self))

    @property
    def train(self) -> np.ndarray:
        """Which rows may be fitted, shape (n_rows,)."""
        return (self.table["split"] == "train").to_numpy()

    @property
    def held_out(self) -> np.ndarray:
        """Which rows no fit may see, shape (n_rows,)."""
        return (self.table["split"] == "holdout").to_numpy()

    @property
    def given(self) -> tuple[str, ...]:
        """The optional conditions that the rows have."""
        return tuple(name for name in OPTIONAL if condition_columns(name, self.robot)[0] in self.table)

    @cached_property
    def rows(self) -> np.ndarray:
        """Packed conditions, shape (n_conditions, n_rows), as `conditions.Row` orders them."""
        parts = []
        for name in Row.sizes(self.robot, self.given):
            if name == "payload":
                parts += [self.table["payload"] == known for known in self.robot.payloads]
            elif name == "marker":
                parts += [self.table["marker"] == known for known in self.robot.markers]
            else:
                parts += [self.table[column] for column in condition_columns(name, self.robot)]
        return np.array([part.to_numpy(dtype=float) for part in parts])

    def only(self, mask: np.ndarray) -> Measurements:
        """Return the rows where mask is true."""
        return replace(self, table=self.table[mask].reset_index(drop=True))

    def on(self, robot: Robot) -> Measurements:
        """Return the same rows for a robot that differs in its dimensions only (a registered base, say)."""
        return replace(self, robot=robot)


def draw_split(measured: Measurements, holdout: float, seed: int) -> Measurements:
    """Return the rows with a split drawn by pose, each payload and session in proportion; an explicit split stays."""
    if "split" in measured.table:
        return measured
    rng = np.random.default_rng(seed)
    table = measured.table.copy()
    table["split"] = "train"
    first, *more = (table[name] for name in blocks_of(table))
    every = reduce(lambda names, further: names + "\n" + further, more, first)
    block = every.groupby(table["pose"]).agg(lambda names: "\n".join(sorted(set(names))))
    for _, group in block.groupby(block, sort=True):
        poses = np.sort(group.index)
        held = rng.permutation(poses)[: round(holdout * len(poses))]
        table.loc[table["pose"].isin(held), "split"] = "holdout"
    return replace(measured, table=table)


def rotations(table: pd.DataFrame) -> np.ndarray:
    """Return the measured rotations of rows, from angles about x, y, z in turn or quaternions; nan where none, (n_rows, 3, 3)."""
    from scipy.spatial.transform import Rotation

    angles = "rx" in table
    stated = table[["rx", "ry", "rz"] if angles else ["qx", "qy", "qz", "qw"]].to_numpy(float)
    there = np.isfinite(stated).all(axis=1)
    found = np.full((len(table), 3, 3), np.nan)
    if there.any():
        turned = Rotation.from_euler("XYZ", stated[there]) if angles else Rotation.from_quat(stated[there])
        found[there] = turned.as_matrix()
    return found


def blocks_of(table: pd.DataFrame) -> list[str]:
    """Return the columns that say under which payload and in which session a pose was measured."""
    return [name for name in BLOCKS if name in table]


def condition_columns(condition: str, robot: Robot) -> list[str]:
    """Return the columns of a table that hold a condition."""
    stems = {"reading": "q", "approach": "approach", "travel": "travel", "torque": "tau"}
    if condition == "wrench":
        return ["fx", "fy", "fz", "mx", "my", "mz"]
    return numbered(stems[condition], robot.n_joints) if condition in stems else [condition]


def column_names(robot: Robot) -> dict[str, str]:
    """Return every column a measurement file may have, without its unit, and the column's dimension ('' for none)."""
    n = robot.n_joints
    names = dict.fromkeys((*LABELS, "qw", "qx", "qy", "qz", *numbered("approach", n)), "")
    for stem in ("q", "travel"):
        names |= {f"{stem}{i + 1}": "angle" if j.kind == "revolute" else "length" for i, j in enumerate(robot.joints)}
    names |= dict.fromkeys(("x", "y", "z", "sigma"), "length")
    names |= dict.fromkeys(("nominal_x", "nominal_y", "nominal_z"), "length")  # of select/poses.csv, filled in
    names |= dict.fromkeys(("rx", "ry", "rz", "sigma_rotation"), "angle")
    names |= dict.fromkeys(("fx", "fy", "fz"), "force") | dict.fromkeys(("mx", "my", "mz"), "moment")
    names |= dict.fromkeys(numbered("tau", n), "moment")
    return names | {"time": "time", "temperature": "temperature"}


def numbered(stem: str, n: int) -> list[str]:
    """Return names with the numbers 1 to n."""
    return [f"{stem}{i + 1}" for i in range(n)]


def split_column(spelled: str, robot: Robot) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit."""
    return (spelled, "") if column_names(robot).get(spelled) == "" else split_unit(spelled) or (spelled, "")
