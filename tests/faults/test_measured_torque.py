"""Torque columns are held against the loads that masses ask for, by joint, before any fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.faults import as_table, corrected, examined
from calflow.faults.measured_torque import comparisons, measured_torque
from calflow.measurements.measurements import Measurements
from calflow.study import load_study
from hidden.case import Case, draw, write_case
from hidden.simulator import Motion, statics


def with_torques(folder, robot="serial", masses=True, **more):
    """A case's measurements with the simulator's holding torques, an offset, friction and noise."""
    case = Case(robot=robot, poses=80, masses=masses, effects=("geometry",), workflow="paper-table", **more)
    write_case(folder, case, np.random.default_rng([3, 1]))
    world = draw(case, np.random.default_rng([3, 1]))
    torque = -statics(world.real, world.rows, Motion.none(len(world.rows), world.real.n)).torque
    rng = np.random.default_rng(5)
    size = np.abs(torque).max(axis=0)
    torque = torque + 0.02 * size + 0.05 * size * world.rows.approach + rng.normal(0, 0.01, torque.shape) * size
    data = load_study(folder).measurements()
    return Measurements(data.robot, data.table.assign(**{f"tau{i + 1}": torque[:, i] for i in range(6)}), data.notes)


def times(data, factors):
    """The torque columns of joints (counted from 1) times factors."""
    table = data.table.copy()
    for joint, factor in factors.items():
        table[f"tau{joint}"] *= factor
    return replace(data, table=table)


@pytest.mark.parametrize(("robot", "masses"), [("serial", True), ("hh800", True), ("serial", False), ("hh800", False)])
def test_torques_that_are_right_are_no_fault(tmp_path, robot, masses):
    """Fails if offset, friction or noise look like a wrong sign or scale, or a joint that is loaded is not compared."""
    data = with_torques(tmp_path, robot, masses)
    assert {one.joint for one in comparisons(data)} >= {1, 2}
    assert measured_torque(data) == ()


@pytest.mark.parametrize("masses", [True, False])
def test_all_signs_wrong_are_turned(tmp_path, masses):
    """Fails if torques that all count the other way are let stand, or told joint by joint; a column of no load is forgotten; or a
    later stage differs.
    """
    data = with_torques(tmp_path, masses=masses)
    wrong = times(data, dict.fromkeys(range(1, 7), -1.0))
    after, found = examined(wrong)
    assert [(one.cause, one.joint, one.action) for one in found] == [("torque-sign", 0, "corrected")]
    assert found[0].statement.startswith("joints 1, 2, 3, 4, 5 and 6: measured torques have the wrong sign")
    np.testing.assert_array_equal(after.table["tau2"], data.table["tau2"])
    again = corrected(wrong, as_table(found, wrong))
    np.testing.assert_array_equal(again.table["tau1"], data.table["tau1"])


def test_torques_as_the_readings_count_are_turned(tmp_path):
    """Fails if torques of just those joints whose readings count the other way are not told from a single wrong column."""
    data = with_torques(tmp_path)
    joints = tuple(replace(joint, sign=-1 if k in (1, 4) else 1) for k, joint in enumerate(data.robot.joints))
    table = data.table.assign(q2=-data.table["q2"], q5=-data.table["q5"])
    backwards = times(Measurements(replace(data.robot, joints=joints), table, data.notes), {2: -1.0, 5: -1.0})
    found = measured_torque(backwards)
    assert [(one.action, [made.quantity for made in one.corrections]) for one in found] == [
        ("corrected", ["tau2", "tau5"])
    ]


def test_one_wrong_sign_is_said_and_not_changed(tmp_path):
    """Fails if a single column is turned although nobody knows what it means, or nothing is said."""
    data = times(with_torques(tmp_path), {3: -1.0})
    after, found = examined(data)
    assert [(one.cause, one.joint, one.action, one.lines) for one in found] == [("torque-sign", 3, "told", ())]
    assert after.table["tau3"].equals(data.table["tau3"])


@pytest.mark.parametrize("masses", [True, False])
def test_a_scale_is_said_and_not_changed(tmp_path, masses):
    """Fails if torques 1.4 times too large pass, another joint is named, or the column is changed."""
    data = times(with_torques(tmp_path, masses=masses), {2: 1.4, 3: 1.4})
    after, found = examined(data)
    assert [(one.cause, one.joint, one.action) for one in found] == [("torque-scale", k, "told") for k in (2, 3)]
    assert "1.4 times" in found[0].statement
    assert after.table.equals(data.table)


def test_without_masses_or_payloads_nothing_can_be_said(tmp_path):
    """Fails if a scale is made up where no known weight tells it."""
    data = with_torques(tmp_path, masses=False, payloads=("none",))
    assert comparisons(times(data, {2: -3.0})) == ()
