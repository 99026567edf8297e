"""Stated poses: a CSV of joint readings, such as a robot's taught poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calflow.design.candidates import pack
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.units import SUFFIXES
from calflow.measurements.cells import read_cells
from calflow.measurements.header import ReadColumn
from calflow.measurements.layout import Layout
from calflow.measurements.values import numbers
from calflow.model import Model
from calflow.robot.robot import Robot


def stated_poses(file: Path, model: Model) -> np.ndarray:
    """Return the joint readings of a pose file [rad, or m], shape (n_poses, n_joints), in whatever unit its columns name.

    Raises:
        InputError: it cannot be read, lacks a joint's column, or holds no poses or such as the robot cannot take.
    """
    cells = read_cells(file, Layout())
    columns = _joint_columns(list(map(str, cells)), model.robot, file)
    read = [numbers(cells[column.theirs], column, Layout(), file) for column in columns]
    wrong = [problem for column in read for problem in column.problems]
    stated = np.zeros((len(cells), model.robot.n_joints))
    stated[:, model.robot.driven] = np.transpose([column.values for column in read])
    empty = np.any([column.empty for column in read], axis=0)
    finite = np.asarray(np.isfinite(stated).all(axis=1))
    packed = pack(model, np.where(finite[:, None], stated, 0.0), "", "")
    closed = np.abs(model.closure_cosine(model.nominal, packed)) < 1
    lines = cells.index.to_numpy()
    problems = [Problem("a joint reading is empty or not a number", file, int(line)) for line in lines[empty]]
    problems += [Problem("the four-bar loop cannot be closed at these joint readings", file, int(line))
                 for line in lines[finite & ~closed]]  # fmt: skip
    if wrong or problems:
        raise InputError([*problems, *wrong])
    return np.asarray(stated)


def _joint_columns(there: list[str], robot: Robot, file: Path) -> list[ReadColumn]:
    """The column of each joint's reading, whatever its unit."""
    found: list[ReadColumn] = []
    problems: list[Problem] = []
    for i in robot.driven:
        joint, name = robot.joints[i], f"q{i + 1}"
        units = SUFFIXES["angle" if joint.kind == "revolute" else "length"]
        ways = [f"{name}_{unit}" for unit in units]
        own = [ReadColumn(name, unit, way, way) for unit, way in zip(units, ways, strict=True) if way in there]
        if not own:
            problems.append(Problem(f"missing column: expected {' or '.join(ways)}{nearest(ways[1], there)}", file, 1))
        elif len(own) > 1:
            problems.append(Problem(f"{own[1]}: '{name}' is there twice, in different units", file, 1))
        else:
            found += own
    if problems:
        raise InputError(problems)
    return found
