"""Robots at rows of their files, shared by all tests of effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered
from calflow.robot.robot import Robot
from effects.bench import BASE, EVERYTHING, ROBOTS, SESSIONS, Bench
from hidden.case import Case, draw, write_case
from hidden.simulator import Motion, Rows, statics


@pytest.fixture(scope="session")
def benches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Bench]:
    """Both robots with files in which nothing is missing."""
    found = {}
    for name in ROBOTS:
        folder = tmp_path_factory.mktemp(name)
        case = Case(robot=name, poses=500, columns=EVERYTHING, base=BASE)
        write_case(folder, case, np.random.default_rng(1))
        world = draw(case, np.random.default_rng(1))
        robot = Robot.from_toml(folder / "robot.toml")
        data = Measurements.from_csv(folder / "measurements.csv", robot)
        data = Measurements(robot, data.table.assign(session=np.repeat(SESSIONS, 500 // len(SESSIONS))))
        few = np.arange(len(data)) % 8 == 0
        rows = Rows(**{part: values[few] for part, values in vars(world.rows).items()})
        rows = replace(rows, time=np.round(rows.time, 2) - world.rows.time.min().round(2))
        still = statics(world.stated, rows, Motion.none(len(rows), world.stated.n))
        found[name] = Bench(robot, data, world.stated, rows, few, still)
    return found


@pytest.fixture(scope="session")
def dense(benches: dict[str, Bench]) -> Measurements:
    """Readings all over the joints' travel."""
    robot = benches["serial"].robot
    q = np.random.default_rng(8).uniform(*robot.limits.T, (800, robot.n_joints))
    return Measurements(robot, pd.DataFrame(q, columns=numbered("q", robot.n_joints)))


@pytest.fixture(scope="session")
def full(benches: dict[str, Bench], dense: Measurements) -> Measurements:
    """Rows in which nothing is missing, and that cover the joints' travel."""
    data = benches["serial"].data
    table = data.table.copy()
    table[numbered("q", 6)] = dense.joints[: len(table)]
    return Measurements(data.robot, table)
