"""Measurements in Python: built, split, compared and printed without a file of their own."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from calflow.faults.implausible import plausible
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot


@pytest.fixture
def robot(small):
    return Robot.from_toml(small / "robot.toml")


@pytest.fixture
def data(small, robot):
    return Measurements.from_csv(str(small / "measurements.csv"), robot)


def arrays(data):
    """What a scientist has in hand: plain arrays."""
    return {name: data.table[name].to_numpy() for name in ("pose", "repeat", "payload", "sigma")}


def test_arrays_make_what_a_file_makes(data, robot):
    """Fails if a column goes astray, a unit is converted again, or a label is filled in otherwise."""
    built = Measurements.from_arrays(robot, data.joints, data.position, marker="tool", **arrays(data))
    pd.testing.assert_frame_equal(built.table[list(data.table.columns)], data.table.assign(line=range(1, 81)))
    np.testing.assert_array_equal(built.conditions, data.conditions)
    bare = Measurements.from_arrays(robot, data.joints.tolist(), data.position.tolist())
    assert bare.table["pose"].nunique() == 40
    assert len(bare.notes) == 2


def test_every_condition_can_be_given_as_an_array(data, robot):
    """Fails if a condition is dropped, or its columns are exchanged."""
    n, rng = len(data), np.random.default_rng(1)
    turns = Rotation.random(n, rng=rng).as_matrix()
    more = {
        "approach": rng.integers(-1, 2, (n, 3)), "travel": rng.random((n, 3)), "wrench": rng.random((n, 6)),
        "torque": rng.random((n, 3)), "time": 100.0 + np.arange(n), "temperature": 293.0,
    }  # fmt: skip
    built = Measurements.from_arrays(
        robot, data.joints, data.position, rotation=turns, sigma_rotation=1e-4, tracker=(3.0, 0.0, 1.0), **more
    )
    assert built.given == ("approach", "travel", "wrench", "torque", "time", "temperature", "order", "range")
    expected = np.column_stack([*(more[name] for name in ("approach", "travel", "wrench", "torque")), np.arange(n)])
    np.testing.assert_allclose(
        built.conditions[6:-3].T, np.column_stack([expected, np.full(n, 293.0)])[:, : -1 or None]
    )
    np.testing.assert_allclose(built.rotation, turns, atol=1e-12)
    np.testing.assert_allclose(built.table["range"], np.linalg.norm(data.position - [3.0, 0.0, 1.0], axis=1))
    assert built.time_origin == 100.0


WRONG = {
    "shape": ({"q": np.zeros((80, 2))}, ["q: expected shape (80, 3), found (80, 2)"]),
    "length": ({"sigma": np.ones(3)}, ["sigma: "]),
    "not finite": ({"position": np.full((80, 3), np.nan)}, [*[f"row {i}: x: expected a finite number" for i in range(1, 6)]]),
    "huge": ({"temperature": 1e300}, ["row 1: temperature: expected at most 1e+07 K"]),
    "unknown": ({"sigmas": 1.0}, ["sigmas: unknown array, did you mean 'sigma'?"]),
    "unknown payload": ({"payload": "havy"}, ["row 1: unknown payload 'havy'"]),
    "several": ({"q": np.zeros(3), "approach": 1.0}, ["q: expected shape", "approach: expected shape (3, 3)"]),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), WRONG.values(), ids=WRONG)
def test_wrong_arrays_are_refused_with_all_that_is_wrong(data, robot, change, expected):
    """Fails if an array of another shape is spread over the rows, or nan reaches a fit."""
    given = {"q": data.joints, "position": data.position, **arrays(data), **change}
    if "several" in str(expected) or len(np.atleast_1d(given["q"])) == 3:
        given = {"q": given["q"], "position": data.position[:3], **change}
    with pytest.raises(InputError) as refused:
        Measurements.from_arrays(robot, given.pop("q"), given.pop("position"), **given)
    told = str(refused.value).splitlines()
    for problem, start in zip(told, expected, strict=False):
        assert problem.startswith(start)
    assert len(told) >= len(expected)


def test_measurements_are_equal_where_all_they_hold_is(small, data, robot):
    """Fails if a comparison ends in an error of pandas, or a value, the robot or the time's origin does not count."""
    assert data == Measurements.from_csv(small / "measurements.csv", robot)
    assert data != data.only(np.arange(80) < 79)
    assert data != replace(data, time_origin=1.0)
    assert data != replace(data, table=data.table.assign(x=data.table["x"] + 1e-9))
    assert data != "data"


def test_they_say_what_they_are(data):
    """Fails if a notebook shows a wall of numbers, or leaves out what the rows have."""
    split = data.split(holdout=0.3, seed=1)
    assert repr(split) == (
        "Measurements(rows: 80, poses: 40, markers: tool, payloads: light, heavy, given: order, "
        "split: 56 rows to fit, 24 held out)"
    )
    html = replace(split, notes=("a < b",))._repr_html_()
    assert "<td>light, heavy</td>" in html
    assert "<li>a &lt; b</li>" in html
    assert repr(Measurements(data.robot, data.table[["q1", "q2", "q3"]])).startswith(
        "Measurements(rows: 80, poses: unkn"
    )


def test_a_foreign_file_is_read_by_keywords(small, data, robot):
    """Fails if a layout that a study can state cannot be stated in Python, or one that cannot be passes."""
    text = (small / "measurements.csv").read_text(encoding="utf-8")
    (small / "excel.csv").write_text(text.replace(",", ";").replace(".", ","), encoding="utf-8")
    assert Measurements.from_csv(small / "excel.csv", robot, separator=";", decimal=",") == data
    with pytest.raises(InputError, match="separator: expected one character"):
        Measurements.from_csv(small / "excel.csv", robot, separator="; ")


def test_arrays_of_degrees_are_not_plausible(data, robot, small):
    """Fails if readings of hundreds of radians pass because no column says their unit."""
    degrees = Measurements.from_arrays(robot, np.rad2deg(data.joints), data.position)
    with pytest.raises(InputError, match="over three turns"):
        plausible(degrees, small / "measurements.csv")


def test_the_table_needs_no_pydantic():
    """Fails if who builds measurements from arrays waits for what reads a study."""
    code = "import calflow.measurements.measurements, sys; print([n for n in sys.modules if n.startswith('calflow.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "calflow.measurements.source" not in done.stdout


def test_points_that_were_not_measured_are_counted(robot):
    """Fails if a row without any position is refused or dropped in silence, or one with a part of a position is taken."""
    rng = np.random.default_rng(2)
    q, position = rng.uniform(-1, 1, (20, robot.n_joints)), rng.uniform(-1, 1, (20, 3))
    position[[4, 9]] = np.nan
    data = Measurements.from_arrays(robot, q, position, in_order=True)
    assert data.table["line"].tolist() == [i for i in range(1, 21) if i not in (5, 10)]
    assert "2 of 20 rows have no measured value and are left out (line 5, 10)" in data.notes
    position[4, 0] = 0.1
    with pytest.raises(InputError, match="row 5: y: expected a finite number"):
        Measurements.from_arrays(robot, q, position)


def test_a_standstill_turns_no_side(robot):
    """Fails if what encoders jitter by while the robot stands turns the side that a joint comes from, or its travel."""
    rng = np.random.default_rng(3)
    pose = np.repeat(np.arange(8), 3)
    q = rng.uniform(-1, 1, (8, robot.n_joints))[pose]
    jitter = 2e-6 * rng.standard_normal(q.shape)
    still, shaken = (
        Measurements.from_arrays(
            robot, readings, np.zeros((24, 3)), pose=pose, repeat=np.tile([1, 2, 3], 8), in_order=True
        )
        for readings in (q, q + jitter)
    )
    sides, travel = ([f"{name}{k + 1}" for k in range(robot.n_joints)] for name in ("approach", "travel"))
    assert (shaken.table[sides].to_numpy() == still.table[sides].to_numpy()).all()
    assert np.allclose(shaken.table[travel], still.table[travel], atol=1e-4)
