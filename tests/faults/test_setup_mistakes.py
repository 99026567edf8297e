"""Mistakes of the user in robot file or table are told as what they are; more of each kind are in benchmarks/mistakes.py."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import robots
from calflow.faults import examined
from calflow.faults.setup import Setup
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.robot.parts import Base, Expected
from calflow.study import load_study
from hidden.case import Case, write_case

STUDIES = Path(__file__).parents[2] / "studies"


def loaded(folder):
    """A loaded 210 kg robot that gives way, by physics apart from the model, with two payloads and none."""
    write_case(folder, Case(poses=70, workflow="paper-table"), np.random.default_rng(77))
    return load_study(folder).measurements()


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Its measurements."""
    return loaded(tmp_path_factory.mktemp("mistakes"))


@pytest.fixture(scope="module")
def weightless(measured):
    """The same robot where nobody knows masses, base or marker."""
    robot = measured.robot
    joints = tuple(replace(joint, mass=None, com=(0.0, 0.0, 0.0)) for joint in robot.joints)
    markers = {name: replace(marker, known=False) for name, marker in robot.markers.items()}
    return measured.on(replace(robot, joints=joints, base=Base(known=False), markers=markers))


def with_figure(data, joint, **values):
    """The data of a robot file with other figures of a joint (from 1)."""
    joints = list(data.robot.joints)
    joints[joint - 1] = replace(joints[joint - 1], frame=joints[joint - 1].frame.restated(values))
    return data.on(replace(data.robot, joints=tuple(joints)))


def with_columns(data, **columns):
    """The data with columns that are something else."""
    return replace(data, table=data.table.assign(**columns))


@pytest.mark.parametrize(
    ("joint", "figures", "said", "known"),
    [
        (4, {"alpha": np.pi / 2}, "joint 4: the twist alpha has the wrong sign; expected alpha_deg = -90", False),
        (4, {"d": 1.82}, r"d of joint 4 is mistyped \(digits exchanged: 1280\); expected", True),
    ],
    ids=["twist", "digits"],
)  # fmt: skip
def test_a_mistyped_figure_is_told_and_no_other(measured, joint, figures, said, known):
    """Fails if signs, axes or another figure are blamed, or the robot is fitted with a figure that cannot be."""
    data = measured if known else measured.on(replace(measured.robot, base=Base(known=False)))
    with pytest.raises(InputError, match=said) as told:
        examined(with_figure(data, joint, **figures))
    others = str(told.value).split("(2)")[1:]
    assert all(f"theta of joint {joint} is mistyped" in other for other in others)  # the same figure, as any


def test_a_supposed_robot_whose_loop_closes_nowhere_is_no_answer():
    """Fails if a mistake cannot be told where another that is tried, such as the other convention, opens the loop."""
    robot = robots.hh800_with_bars(crank=0.4, rocker=0.4)
    q = robots.poses(robot, 60)
    data = Measurements.from_arrays(robot, q, robots.marker_position(robot, q)).split(0.2, 1)
    with pytest.raises(InputError, match="joint 5: the twist alpha has the wrong sign"):
        examined(with_figure(data, 5, alpha=np.pi / 2))


@pytest.mark.parametrize(("joint", "figures"), [(4, {"theta": np.pi}), (4, {"alpha": -np.deg2rad(np.pi / 2)})])
def test_without_its_mistake_a_file_explains_what_the_right_one_does(weightless, joint, figures):
    """Fails if springs of unknown masses act in a mistaken figure's frames, or other figures are free than by the right file."""
    right, wrong = Setup.of(weightless), Setup.of(with_figure(weightless, joint, **figures))
    (symbol,) = figures
    k = [p.identity[2:] for p in wrong.model.parameters].index((f"joint{joint}", symbol))
    stated = weightless.robot.frames[joint - 1].figures[symbol]
    undone = wrong.with_dimensions({k: stated - figures[symbol]}).restated.fitted
    assert undone.evidence == pytest.approx(right.fitted.evidence, abs=0.01)


def test_a_sign_is_not_turned_where_a_joints_zero_does_the_same(weightless):
    """Fails if readings are turned in memory where a wrist reads as well with the zero of the joint before half a turn on.

    Where loads are known gravity tells them apart: with the sign turned they would hang on the flange's other side.
    """
    wrong = with_figure(weightless, 4, theta=np.pi)
    with pytest.raises(InputError, match="can correct it: joint 4: its zero is off by 180 deg"):
        examined(wrong)
    with pytest.raises(InputError) as told:
        examined(wrong.only((wrong.table["payload"] == "none").to_numpy()))
    assert "joint 4: its zero is off by 180 deg" in str(told.value)
    assert "joint 5: all readings have the wrong sign" in str(told.value)


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA does not name the folder with measured data")
def test_columns_exchanged_are_told_beside_the_limits_that_are_passed_so():
    """Fails if only the limits of a real robot are complained of, or it is taken for another robot, as markers are unknown."""
    data = load_study(STUDIES / "fanuc-r2000").measurements()
    with pytest.raises(InputError) as told:
        examined(with_columns(data, q5=data.table["q6"], q6=data.table["q5"]))
    assert "columns q5 and q6 are exchanged" in str(told.value)
    assert "joint 5: in lines" in str(told.value)


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA does not name the folder with measured data")
def test_a_length_of_a_real_robot_is_told_however_wrong():
    """Fails if a fit from the typed figure ends far from the right one, or repeats of few poses count as few poses."""
    assert_typed("fanuc-r2000", 1 / 25.4)


def assert_typed(study, typed):
    """A length of a real robot that is typed so many times as long is told with the right one; benchmarks/slow has the UR10."""
    data = load_study(STUDIES / study).measurements()
    right = data.robot.frames[1].figures["a"]
    try:
        (fault,) = examined(with_figure(data, 2, a=right * typed))[1]
        told = fault.statement
    except InputError as refused:
        told = str(refused)
    assert "a of joint 2 is mistyped" in told
    assert f"expected about a_mm = {1e3 * right:.0f}" in told
    assert "(2)" not in told


def test_a_wide_study_changes_nothing(measured):
    """Fails if limits that a study sets let a wrong robot explain the positions."""
    wide = tuple(
        Expected("geometry", f"joint{i}", symbol, unit, 0.0, 0.5, lower=-3.0, upper=3.0)
        for i in range(2, 7) for symbol, unit in (("alpha", "rad"), ("a", "m"), ("theta", "rad"))
    )  # fmt: skip
    data = measured.on(replace(measured.robot, expected=wide))
    assert examined(data)[1] == ()
    with pytest.raises(InputError, match="joint 4: the twist alpha has the wrong sign"):
        examined(with_figure(data, 4, alpha=np.pi / 2))


@pytest.mark.filterwarnings("error")
def test_a_change_before_the_first_fitted_row_is_no_fit(measured):
    """Fails if a change is measured by fitted rows alone where all before it are held out: the size of no errors is none."""
    early = np.arange(len(measured)) < 6
    table = measured.table.assign(
        q2=measured.table["q2"] + 0.1 * early, split=measured.table["split"].mask(early, "holdout")
    )
    assert [fault.cause for fault in examined(replace(measured, table=table))[1]] == ["row-misalignment"]


def test_a_marker_far_from_where_it_is_typed(measured):
    """Fails if the fit takes a marker to its bound, or says that a joint is at fault."""
    robot = replace(measured.robot, markers={"E": replace(measured.robot.markers["E"], point=(0.15, 0.12, 0.392))})
    with pytest.raises(InputError, match="marker E is mistyped"):
        examined(measured.on(robot))


def test_a_tool_stated_far_off_is_told_though_the_base_is_unknown(measured):
    """Fails if its figure ends at a bound of the fit without a word, or one that the fit can correct is refused."""
    tool, base = measured.robot.markers["E"], Base(known=False)
    longer = [replace(tool, point=(*tool.point[:2], tool.point[2] + by)) for by in (0.1, 0.25)]
    near, far = (measured.on(replace(measured.robot, base=base, markers={"E": marker})) for marker in longer)
    assert examined(near)[1] == ()
    with pytest.raises(InputError, match=r"marker E is mistyped, 25\d mm off; expected about point_mm"):
        examined(far)


def swapped(data):
    """The rows of two payloads under each other's name."""
    return with_columns(data, payload=data.table["payload"].replace({"half": "full", "full": "half"}))


def test_payloads_of_each_others_name_and_in_pounds_are_told(measured):
    """Fails if two payloads that were taken for each other, or pounds for kilograms, pass unsaid."""
    (fault,) = examined(swapped(measured))[1]
    assert fault.cause == "payloads-exchanged"
    pounds = {name: replace(load, mass=load.mass / 0.45359) for name, load in measured.robot.payloads.items()}
    (fault,) = examined(measured.on(replace(measured.robot, payloads=pounds)))[1]
    assert "the masses of all payloads are in pounds" in fault.statement


def test_springs_that_may_not_push_are_paid_for_as_those_that_pull(measured):
    """Fails if a set-up is the more probable the more springs it holds at none, as loads of each other's name may."""
    setup = Setup.of(measured)
    hung = setup.with_robot(replace(setup.model.robot, gravity=(0.0, 0.0, 9.8))).fitted
    springs = [k for k, p in enumerate(hung.setup.model.parameters) if p.effect == "joint-compliance"]
    held = [k for k in springs if not hung.estimate[k]]
    assert len(held) >= 3
    assert hung.volume < hung.setup.without_springs.fitted.volume - 0.5 * len(held)


def test_a_device_that_was_moved_at_a_row(measured):
    """Fails if the row is not told, outliers are left out in its place, or one that is typed in mm outweighs all others."""
    later = (np.arange(len(measured)) >= 41)[:, None]
    x, y, z = np.where(later, measured.position + np.array([0.03, 0.0, 0.02]), measured.position).T
    x[[3, 55]] *= 1000
    (fault,) = examined(with_columns(measured, x=x, y=y, z=z))[1]
    assert (fault.cause, fault.action) == ("device-moved", "unsettled")
    assert f"from line {measured.table['line'][41]} on" in fault.statement


def heavier(data):
    """The data of a robot file that states a load of two thirds of the true one."""
    load = data.robot.payloads["full"]
    payloads = dict(data.robot.payloads) | {"full": replace(load, mass=2 / 3 * load.mass)}
    return data.on(replace(data.robot, payloads=payloads))


def test_rows_that_bear_another_payloads_name_are_put_right(measured):
    """Fails if a run of rows typed alike, or single ones, are taken for joints that do not repeat, or a good row is touched."""
    load, typed = measured.table["payload"].to_numpy(str), measured.table["payload"].to_numpy(str).copy()
    rows = np.flatnonzero(load == "full")[[1, 5, *range(9, 14)]]
    typed[rows] = "none"
    found, (fault,) = examined(with_columns(measured, payload=typed))
    assert (fault.cause, fault.action) == ("name-mistyped", "corrected")
    assert [made.row - 1 for made in fault.corrections] == rows.tolist()
    assert "payload full, which is not what is written" in fault.statement
    assert found.table["payload"].tolist() == load.tolist()


def test_rows_whose_load_has_a_weight_that_no_payload_has_are_left_out(measured):
    """Fails if such rows are given the name that comes next, are taken for the robot's, or another row is left out."""
    load, number = measured.table["payload"].to_numpy(str), np.arange(len(measured))
    unknown = (load == "half") & (number > 20) & (number < 45)
    kept = unknown | (load == "none") | ((load == "full") & ((number <= 20) | (number >= 45)))
    robot = measured.robot
    payloads = {name: payload for name, payload in robot.payloads.items() if name != "half"}
    typed = with_columns(measured, payload=np.where(load == "half", "full", load)).only(kept)
    _, (fault,) = examined(typed.on(replace(robot, payloads=payloads)))
    assert (fault.cause, fault.action) == ("load-unknown", "left out")
    assert [made.row - 1 for made in fault.corrections] == np.flatnonzero(unknown[kept]).tolist()
    assert f"a load of {robot.payloads['half'].mass / robot.payloads['full'].mass:.2g} times" in fault.statement


def test_a_load_that_is_heavier_than_stated_is_no_mistyped_name(measured):
    """Fails if rows whose load the robot file states wrongly are given another's name, or rows that are right are."""
    for data in (measured, heavier(measured)):
        assert "name-mistyped" not in [fault.cause for fault in examined(data)[1]]


def test_one_position_in_all_rows_is_told_as_such(measured):
    """Fails if a row copied into all others is told as a mistake of units or signs."""
    x, y, z = measured.position[0]
    with pytest.raises(InputError, match=r"all 70 positions are the same, \(.*\) mm"):
        examined(with_columns(measured, x=x, y=y, z=z))


def test_a_device_that_was_moved_within_a_session(measured):
    """Fails if the names of sessions hide the row, or all of them are said to be apart, of which a frame each mends nothing."""
    later = (np.arange(len(measured)) >= 41)[:, None]
    x, y, z = np.where(later, measured.position + np.array([0.03, 0.0, 0.02]), measured.position).T
    session = np.array(["Mon", "Tue", "Wed"])[np.arange(len(measured)) * 3 // len(measured)]
    (fault,) = examined(with_columns(measured, x=x, y=y, z=z, session=session))[1]
    assert (fault.cause, fault.action) == ("device-moved", "unsettled")
    assert f"from line {measured.table['line'][41]} on" in fault.statement
    assert f"give the rows of session '{session[41]}' from there on" in fault.statement


def test_rows_that_are_read_otherwise_from_one_on_are_put_right(measured):
    """Fails if half of a table whose axes are exchanged is fitted as it is, left out, or the device is said to have moved."""
    _, y, z = measured.position.T
    later = np.arange(len(measured)) >= 33
    after, (fault,) = examined(with_columns(measured, y=np.where(later, z, y), z=np.where(later, y, z)))
    assert (
        f"from line {measured.table['line'][33]} on, not before: x, y, z are no right-handed frame" in fault.statement
    )
    np.testing.assert_array_equal(after.position, measured.position)


def test_a_joint_that_was_mastered_anew_beside_single_typing_errors(measured):
    """Fails if rows that are off by themselves, the last among those after it, outweigh the step of all others."""
    x, later = measured.table["x"].to_numpy(copy=True), np.arange(len(measured)) >= 41
    x[[3, 55]] *= [1000, -10]
    (fault,) = examined(with_columns(measured, x=x, q2=measured.table["q2"] - later * np.deg2rad(1)))[1]
    assert (fault.cause, fault.joint) == ("zero-changed", 2)
    assert f"from line {measured.table['line'][41]} on the readings of joint 2 are 1 deg too small" in fault.statement


def test_two_rows_that_are_exchanged(measured):
    """Fails if they are called outliers, or not put right."""
    table = measured.table.copy()
    table.loc[[5, 30], ["x", "y", "z"]] = table.loc[[30, 5], ["x", "y", "z"]].to_numpy()
    after, (fault,) = examined(Measurements(measured.robot, table, measured.notes))
    assert fault.cause == "rows-exchanged"
    np.testing.assert_array_equal(after.position, measured.position)


def test_two_poses_that_are_exchanged_with_all_their_repeats(measured):
    """Fails if they are called outliers since any repeat of the one mends any of the other, or are not put right."""
    rng = np.random.default_rng(3)
    again = measured.table.assign(repeat=measured.table["repeat"] + 1)
    again[["x", "y", "z"]] += rng.normal(0, 2e-5, (len(again), 3))
    whole = pd.concat([measured.table, again], ignore_index=True)
    whole["line"] = np.arange(2, len(whole) + 2)
    twice = Measurements(measured.robot, whole, measured.notes)
    one, other = [5, 5 + len(again)], [30, 30 + len(again)]
    table = whole.copy()
    table.loc[one + other, ["x", "y", "z"]] = whole.loc[other + one, ["x", "y", "z"]].to_numpy()
    after, (fault,) = examined(Measurements(measured.robot, table, measured.notes))
    assert fault.cause == "rows-exchanged"
    np.testing.assert_array_equal(after.position, twice.position)
