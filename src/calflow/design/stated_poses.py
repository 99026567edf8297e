"""Stated poses: a CSV of joint readings, such as a robot's taught poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.design.candidates import pack
from calflow.files.problems import InputError, Problem, nearest, refuse
from calflow.files.regular import regular_file
from calflow.files.units import SUFFIXES, split_unit, to_si
from calflow.model import Model
from calflow.robot.robot import Robot


def stated_poses(file: Path, model: Model) -> np.ndarray:
    """Return the joint readings of a pose file [rad, or m], shape (n_poses, n_joints), in whatever unit its columns name.

    Raises:
        InputError: it cannot be read, lacks a joint's column, or holds no poses or such as the robot cannot take.
    """
    try:
        table = pd.read_csv(regular_file(file), skip_blank_lines=False).dropna(how="all")
    except FileNotFoundError:
        raise refuse("no such file", file) from None
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be read: {error}", file) from None
    columns = _joint_columns(list(map(str, table)), model.robot, file)
    if table.empty:
        raise refuse("holds no poses", file)
    factors = [to_si((split_unit(name) or ("", ""))[1])[0] for name in columns]
    stated = np.zeros((len(table), model.robot.n_joints))
    stated[:, model.robot.driven] = factors * table[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    finite = np.asarray(np.isfinite(stated).all(axis=1))
    packed = pack(model, np.where(finite[:, None], stated, 0.0), "", "")
    closed = np.abs(model.closure_cosine(model.nominal, packed)) < 1
    lines = table.index.to_numpy() + 2
    problems = [Problem("a joint reading is empty or not a number", file, int(line)) for line in lines[~finite]]
    problems += [Problem("the four-bar loop cannot be closed at these joint readings", file, int(line))
                 for line in lines[finite & ~closed]]  # fmt: skip
    if problems:
        raise InputError(problems)
    return np.asarray(stated)


def _joint_columns(there: list[str], robot: Robot, file: Path) -> list[str]:
    """The column of each joint's reading, whatever its unit."""
    found: list[str] = []
    problems: list[Problem] = []
    for i in robot.driven:
        joint = robot.joints[i]
        ways = [f"q{i + 1}_{unit}" for unit in SUFFIXES["angle" if joint.kind == "revolute" else "length"]]
        name = next((way for way in ways if way in there), None)
        if name is None:
            problems.append(Problem(f"missing column: expected {' or '.join(ways)}{nearest(ways[1], there)}", file, 1))
        else:
            found.append(name)
    if problems:
        raise InputError(problems)
    return found
