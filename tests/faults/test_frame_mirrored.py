"""A left-handed measuring frame is told as one, and joints that count the other way as these."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from calflow.faults import as_table, corrected, examined
from calflow.files.problems import InputError
from calflow.files.tables import EXACT, csv_text
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.parts import Base
from calflow.study import load_study
from hidden.case import Case, write_case

NOWHERE = Base(known=False)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A symmetric robot of 40 poses, whose base and marker are stated."""
    folder = tmp_path_factory.mktemp("mirrored")
    case = Case(poses=40, payloads=("none",), effects=("geometry",), noise="range", workflow="paper-table")
    write_case(folder, case, np.random.default_rng(31))
    return load_study(folder).measurements()


def changed(data, **columns):
    """The data with columns that are something else."""
    return Measurements(data.robot, data.table.assign(**columns), data.notes)


def exchanged(data, first, second):
    """The data with two columns that stand for each other."""
    return changed(data, **{first: data.table[second], second: data.table[first]})


@pytest.mark.parametrize("wrong", ["x", "y and z"])
def test_the_axes_are_told_where_the_base_is_known(measured, wrong):
    """Fails if joints are blamed, another axis is, the rows are not put right, or a later stage sees other rows."""
    first, _, second = wrong.partition(" and ")
    data = exchanged(measured, first, second) if second else changed(measured, **{wrong: -measured.table[wrong]})
    after, (found,) = examined(data)
    assert (found.cause, found.joint, found.action, found.lines) == ("frame-mirrored", 0, "corrected", ())
    assert (f"the axes {wrong} are exchanged" if second else f"the axis {wrong} is reversed") in found.statement
    pd.testing.assert_frame_equal(after.table, measured.table)
    table = pd.read_csv(io.StringIO(csv_text(as_table((found,), data))), **EXACT)
    pd.testing.assert_frame_equal(corrected(data, table).table, after.table)


def test_a_mirrored_frame_of_a_robot_that_stands_anywhere(measured):
    """Fails if a base that nobody knows, or one row that is far off, hides that the frame is left-handed."""
    table = measured.table.assign(y=-measured.table["y"])
    table.loc[3, "x"] += 2.0
    data = Measurements(replace(measured.robot, base=NOWHERE), table, measured.notes)
    after, found = examined(data)
    assert [fault.cause for fault in found] == ["frame-mirrored", "outlier"]
    assert "or other axes, with another rotation of the base" in found[0].statement
    assert list(after.table["range"]) == list(measured.table["range"])


def test_orientations_tell_which_axis(measured):
    """Fails if orientations that were exported right do not say which axis was turned, whatever base and tool."""
    turn = Rotation.from_euler("XYZ", [0.3, -0.7, 2.1])
    robot = replace(measured.robot, base=NOWHERE, tool_rotation=(0.0, 0.0, 0.0))
    model = build(measured.robot, (), measured.given)
    seen = (
        turn
        * Rotation.from_matrix(model.rotation(model.nominal, measured.conditions))
        * Rotation.from_rotvec([0.5, 1.0, 0])
    )
    place = turn.apply(measured.position.copy())
    rx, ry, rz = seen.as_euler("XYZ").T
    columns = {"x": place[:, 0], "y": place[:, 1], "z": -place[:, 2], "rx": rx, "ry": ry, "rz": rz}
    (found,) = examined(changed(measured.on(robot), **columns))[1]
    assert "the axis z is reversed;" in found.statement


def test_joints_that_count_the_other_way_are_no_mirror(measured):
    """Fails if a known base and marker do not tell joints 1, 4 and 6 from a mirror."""
    three = changed(measured, **{name: -measured.table[name] for name in ("q1", "q4", "q6")})
    (found,) = examined(three)[1]
    assert (found.cause, found.action) == ("joint-sign", "corrected")
    assert "joints 1, 4 and 6: all readings have the wrong sign" in found.statement


@pytest.mark.parametrize(("turn", "known"), [([np.pi, 0, 0], True), ([0.4, -1.0, 2.8], False)])
def test_a_base_that_is_turned_is_no_fault_of_joints(measured, turn, known):
    """Fails if joints or a mirror are blamed for what another base explains."""
    robot = measured.robot if known else replace(measured.robot, base=NOWHERE)
    place = Rotation.from_rotvec(turn).apply(measured.position.copy())
    data = changed(measured.on(robot), **dict(zip("xyz", place.T, strict=True)))
    if not known:
        assert examined(data)[1] == ()
        return
    with pytest.raises(InputError, match="no fit can correct it: the base is not where the robot file states it"):
        examined(data)
