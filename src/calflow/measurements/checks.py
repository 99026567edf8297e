"""Checks of a measurement file: what cannot be right is told with its line before any fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calflow.files.problems import Problem, nearest
from calflow.files.units import SUFFIXES
from calflow.measurements.measurements import Measurements, MeasurementSource, column_names, numbered, split_column
from calflow.robot.robot import Robot

MAX_ROWS_TOLD = 5  # a message names this many rows of a kind, then counts the rest
MEASURED = ("x", "y", "z", "rx", "ry", "rz", "qw", "qx", "qy", "qz")
SHAPE_ROWS = 200  # rows whose distances from each other tell a wrong unit
SHAPE_WRONG = 0.3  # they disagree with the nominal robot's by more than this as named
SHAPE_RIGHT = 0.1  # and by less than this in the unit that is meant


def check_header(
    spelled: list[str], columns: dict[str, tuple[str, str]], source: MeasurementSource, robot: Robot, path: Path,
    conditions_only: bool,
) -> list[Problem]:  # fmt: skip
    """Find columns that are unknown, doubled, without their unit, or missing."""
    known, problems = column_names(robot), []

    def tell(message: str) -> None:
        problems.append(Problem(message, path, 1))

    for column in spelled:
        name, unit = split_column(column, robot)
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
    required = numbered("q", robot.n_joints) + ([] if conditions_only else ["x", "y", "z"])
    if len(robot.markers) > 1:
        required.append("marker")
    groups = (numbered("approach", robot.n_joints), numbered("tau", robot.n_joints), ["fx", "fy", "fz", "mx", "my", "mz"],
              ["rx", "ry", "rz"], ["qw", "qx", "qy", "qz"])  # fmt: skip
    return required + [name for group in groups if any(n in columns for n in group) for name in group]


def mapped(source: MeasurementSource) -> list[str]:
    """The foreign file's columns that the study's mapping names."""
    return [*source.columns.values(), *(name for marker in source.markers.values() for name in marker.values())]


def check_values(table: pd.DataFrame, robot: Robot, path: Path) -> list[Problem]:
    """Find names that the robot file lacks, rows that contradict each other, and values out of range."""
    problems: list[Problem] = []
    for name, known, optional in (("marker", robot.markers, False), ("payload", robot.payloads, True)):
        for value in table[name].unique():
            if value not in known and not (optional and value == ""):
                names = ", ".join(known) or "none"
                problems += at_rows(table[name] == value, table, path,
                                  f"unknown {name} '{value}'; the robot file has {names}{nearest(value, known)}")  # fmt: skip
    for i in range(robot.n_joints):
        if f"approach{i + 1}" in table:
            wrong = ~table[f"approach{i + 1}"].isin([-1, 0, 1, np.nan])
            problems += at_rows(wrong, table, path, f"approach{i + 1}: expected -1, 0 or 1")
    for name in ("sigma", "sigma_rotation"):
        if name in table:
            problems += at_rows(table[name] <= 0, table, path, f"{name}: expected a positive standard deviation")
    if "qw" in table:
        norm = np.linalg.norm(table[["qw", "qx", "qy", "qz"]], axis=1)
        problems += at_rows(np.abs(norm - 1) > 0.01, table, path, "qw, qx, qy, qz: expected a quaternion of norm 1")
    if "split" in table:
        split = table["split"].where(table["split"].isin(["train", "holdout"]))
        problems += at_rows(split.isna(), table, path, "split: expected 'train' or 'holdout'")
        mixed = split.groupby(table["pose"]).transform("nunique") > 1
        problems += at_rows(mixed, table, path, "split: one pose is in train and in holdout; held out is a whole pose")
    twice = table.duplicated(["pose", "repeat", "marker"], keep="first") & (table["pose"] != "")
    problems += at_rows(twice, table, path, "duplicate pose: the same pose, repeat and marker stand in an earlier row")
    joints = table[numbered("q", robot.n_joints)]
    moved = (joints - joints.groupby(table["pose"]).transform("first")).abs().max(axis=1) > 0.02
    problems += at_rows(
        moved & ~twice,
        table,
        path,
        "duplicate pose: this pose number has other joint readings in an earlier row",
    )
    return problems


def check_units(measured: Measurements, named: set[str], path: Path, conditions_only: bool) -> list[Problem]:
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
    if _disagreement(measured, 1.0, 1.0) < SHAPE_WRONG:
        return []
    found = {(turn, stretch): _disagreement(measured, turn, stretch) for turn in turns for stretch in stretches}
    best = min(found, key=lambda units: found[units])
    if found[best] > SHAPE_RIGHT:
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


def check_loop(measured: Measurements, path: Path) -> list[Problem]:
    """Find the rows at which a four-bar loop cannot be closed."""
    if measured.robot.loop is None:
        return []
    from calflow.model import build

    nominal = build(measured.robot, (), measured.given)
    open_ = np.abs(nominal.closure_cosine(nominal.nominal, measured.rows)) >= 1
    return at_rows(open_, measured.table, path, "the four-bar loop cannot be closed at these joint readings")


def at_rows(bad: Any, table: pd.DataFrame, path: Path, message: str) -> list[Problem]:
    """One problem a row for the first few bad rows, and one that counts the rest."""
    lines = table["line"].to_numpy()[np.asarray(bad, dtype=bool)]
    problems = [Problem(message, path, int(line)) for line in lines[:MAX_ROWS_TOLD]]
    if len(lines) > MAX_ROWS_TOLD:
        problems.append(Problem(f"{message} (and {len(lines) - MAX_ROWS_TOLD} more rows)", path))
    return problems
