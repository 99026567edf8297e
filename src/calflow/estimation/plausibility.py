"""Plausibility: whether measurements can be of this robot, by what its nominal geometry can do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calflow.files.problems import InputError, Problem
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import at_rows
from calflow.model import build

SHAPE_ROWS = 200  # rows whose distances from each other tell a wrong unit
SHAPE_WRONG = 0.3  # they disagree with the nominal robot's by more than this as named
SHAPE_RIGHT = 0.1  # and by less than this in the unit that is meant
FEWEST = 3  # poses, of which no shape can be told


def plausible(measured: Measurements, path: Path) -> Measurements:
    """Return measurements, or rows to be predicted, that can be of their robot.

    Raises:
        InputError: they are in other units than their columns say, or at joint readings that the robot cannot have.
    """
    problems = check_units(measured, path) or check_loop(measured, path)
    if problems:
        raise InputError(problems)
    return measured


def check_units(measured: Measurements, path: Path) -> list[Problem]:
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
    if "x" not in measured.table or measured.table["pose"].nunique() <= FEWEST:
        return []
    named, turns, stretches = measured.units, {1.0: ""}, {1.0: ""}
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
    nominal = build(measured.robot, (), measured.given)
    open_ = np.abs(nominal.closure_cosine(nominal.nominal, measured.rows)) >= 1
    return at_rows(open_, measured.table, path, "the four-bar loop cannot be closed at these joint readings")
