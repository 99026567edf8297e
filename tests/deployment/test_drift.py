"""Drift: what moved is found and named, what did not raises no alarm, and what the check poses cannot show is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.commands.console import exit_code
from calflow.deployment.drift import drift
from calflow.deployment.movements import CheckProblem, movements
from calflow.deployment.validation import validate
from calflow.design.candidates import candidates
from calflow.effects.session_frame import SessionFrame
from calflow.estimation.extrapolation import Later
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series, Station
from calflow.model import build
from calflow.observations.position import Position
from estimation.data import POSES, calibrated, calibration, wavering
from robots import industrial

NOISE, KNOWN_TO = 5e-5, 2e-5  # m; and m and rad to which the calibration knew every figure
EFFECTS = ("geometry", "joint-compliance")


@pytest.fixture(scope="module")
def robot():
    """A calibrated robot of the 210 kg class, and eight poses to check it by."""
    model = build(industrial(), EFFECTS)
    sd = np.array([1e-8 if one.effect == "joint-compliance" else KNOWN_TO for one in model.parameters])
    estimate = model.nominal + np.where(sd < 1e-7, 2e-7, 3e-4)
    known = calibration(model, estimate, np.diag(sd**2), NOISE)
    return known, candidates(model, 8, "load", "E", None, np.random.default_rng(4))[0]


def checked(known, q, seed, shift=None, since=0, dates=("",), wrong=True, **more):
    """What the device sees of the poses at each date; a shift of readings is there from one of them on."""
    rng = np.random.default_rng(seed)
    model, robot = known.model, known.model.robot
    root = np.sqrt(np.diag(known.covariance))
    p = known.estimate + wrong * root * rng.standard_normal(len(root))
    blocks = []
    for k in range(len(dates)):
        moved = q + (shift if shift is not None and k >= since else 0.0)
        rows = Measurements.from_arrays(robot, moved, None, payload="load").stating(model.given)
        blocks.append(model.point(p, rows.conditions) + NOISE * rng.standard_normal((len(q), 3)))
    session = {"session": np.repeat(dates, len(q))} if len(dates) > 1 else {}
    labels = {"pose": np.tile(np.arange(len(q)), len(dates)), "repeat": np.repeat(np.arange(len(dates)), len(q))}
    n = len(q) * len(dates)
    return Measurements.from_arrays(
        robot, np.tile(q, (len(dates), 1)), np.vstack(blocks), payload="load", sigma=np.full(n, NOISE), split="train",
        **labels, **session, **more,
    )  # fmt: skip


def zero(joint, size):
    """A shift of one joint's reading."""
    return size * np.eye(6)[joint - 1]


def test_a_shifted_zero_is_found_with_its_joint_and_size(robot):
    """Fails if a tenth of a millirad of a joint is missed, another one is named, or its size is not within what is stated."""
    known, q = robot
    for joint in (2, 3):
        found = drift(known, checked(known, q, joint, zero(joint, 2e-4)), station="known")
        assert found.summary.status == "moved"
        assert found.moved[0].joint == joint
        own = next(one for one in found.candidates if one.movement == f"joint{joint}.zero")
        assert abs(own.shifts[0] - 2e-4) < 4 * own.sds[0]
        assert found.summary.left_mm < found.summary.error_mm


def test_a_zero_corrected_as_advised_is_in_place_again(robot):
    """Fails if the shift, added to the joint's reading as the report advises, has the wrong sign or size."""
    known, q = robot
    data = checked(known, q, 4, zero(3, 4e-4))
    (shift,) = drift(known, data, station="known").recalibration
    corrected = replace(data, table=data.table.assign(q3=data.table["q3"] + shift.shift))
    assert shift.movement == "joint3.zero"
    assert drift(known, corrected, station="known").summary.status == "in place"


def test_where_hardly_anything_could_be_seen_nothing_is_in_place(robot):
    """Fails if a check by a device that would not show what a robot was calibrated for passes for one."""
    known, q = robot
    data = checked(known, q, 6)
    coarse = replace(data, table=data.table.assign(sigma=0.02))
    found = drift(known, coarse, station="known").summary
    assert (found.status, exit_code(found.status)) == ("cannot be seen", 5)
    assert found.unseen_mm > found.usual_mm > 0
    assert drift(known, data, station="known").summary.status == "in place"


def test_dates_are_told_by_time_alone(robot):
    """Fails if the same poses, measured again days later, are averaged with those from before the joint moved."""
    known, q = robot
    days = np.repeat([0.0, 5 * 86400.0], len(q))
    data = checked(known, q, 5, zero(3, 4e-4), since=1, dates=("mon", "sat"), time=days)
    found = drift(known, replace(data, table=data.table.drop(columns="session")), station="known")
    assert (found.moved[0].joint, found.summary.sessions, found.summary.poses) == (3, 2, 2 * len(q))
    assert (found.moved[0].since, found.moved[0].before) == ("120.0 h", "0.0 h")
    assert abs(found.recalibration[0].shift - 4e-4) < 4 * found.recalibration[0].sd


def test_a_tool_s_shift_is_in_the_flange_s_axes():
    """Fails if a tool that is turned on its flange has its shift told in its own axes, which no marker is stated in."""
    model = build(replace(industrial(), tool_rotation=(0.3, 1.2, -0.8)), ("geometry",))
    q = candidates(model, 8, "load", "E", None, np.random.default_rng(4))[0]
    rows = Measurements.from_arrays(model.robot, q, None, payload="load").stating(())
    known = calibration(model, model.nominal, 1e-12 * np.eye(len(model.nominal)), NOISE)
    shift = np.array([2e-4, -1e-4, 3e-4])
    marker = model.robot.markers["E"]
    moved = replace(model.robot, markers={"E": replace(marker, point=tuple(np.add(marker.point, shift)))})
    there = build(moved, ()).point(np.zeros(0), rows.conditions) - build(model.robot, ()).point(
        np.zeros(0), rows.conditions
    )
    tool = next(one for one in movements(known, rows, False) if one.name == "tool")
    np.testing.assert_allclose(tool.slope @ shift, there, rtol=0, atol=1e-12)


def test_nothing_is_found_where_nothing_moved(robot):
    """Fails if the calibration's own errors or the device's noise raise alarms more often than stated."""
    known, q = robot
    alarms = [
        drift(known, checked(known, q, seed), station="known", false_alarm=0.05).summary.status != "in place"
        for seed in range(12)  # benchmarks/drift.py has more
    ]
    assert sum(alarms) <= 3


def test_false_alarms_rarer_than_draws_can_tell_still_let_a_shift_be_found(robot):
    """Fails if a level below one of all draws is never reached, or a limit is stated that such a level does not keep."""
    known, q = robot
    found = drift(known, checked(known, q, 3, zero(2, 5e-4)), station="known", false_alarm=1e-4)
    assert found.moved[0].joint == 2
    assert found.moved[0].p < 1e-4
    rare, usual = (drift(known, checked(known, q, 3), station="known", false_alarm=alarm) for alarm in (1e-4, 1e-2))
    at = [next(x.limits[0] for x in one.candidates if x.movement == "joint2.zero") for one in (rare, usual)]
    assert 1.1 * at[1] < at[0] < 2 * at[1]


def test_since_when_is_told_where_there_are_dates(robot):
    """Fails if a shift that came between two dates is told of another one, or of all."""
    known, q = robot
    data = checked(known, q, 5, zero(2, 3e-4), since=2, dates=("March", "April", "May"))
    found = drift(known, data, station="known")
    assert (found.moved[0].since, found.moved[0].before) == ("May", "April")


def test_a_device_that_stood_elsewhere_is_no_drift(robot):
    """Fails if a new station is taken for the robot's foot, or a joint's shift is not found beside it."""
    known, q = robot
    data = checked(known, q, 6)
    away = data.table.assign(x=data.table["y"] + 3.0, y=-data.table["x"], z=data.table["z"] - 0.5)
    still = drift(known, replace(data, table=away))
    assert (still.summary.station, still.summary.status) == ("fitted", "in place")
    data = checked(known, q, 6, zero(3, 4e-4))
    away = data.table.assign(x=data.table["y"] + 3.0, y=-data.table["x"], z=data.table["z"] - 0.5)
    found = drift(known, replace(data, table=away))
    assert found.summary.status == "moved"
    assert "station" not in [one.movement for one in found.candidates]


def test_rows_that_do_not_state_their_noise_have_that_of_the_calibration(robot):
    """Fails if check poses without a column of noise are taken for exact, or for nothing that can be judged."""
    known, q = robot
    data = checked(known, q, 6)
    silent = replace(data, table=data.table.drop(columns="sigma"))
    stated, found = (drift(known, rows, station="known").summary for rows in (data, silent))
    assert found.expected_mm == pytest.approx(stated.expected_mm)
    assert found.status == "in place"


def test_warm_links_are_conditions_and_no_drift(robot):
    """Fails if ten kelvin of all links are told as a robot that moved."""
    known, q = robot
    data = checked(known, q, 7)
    warm = next(one for one in movements(known, data, True) if one.name == "temperature")
    grown = data.position + (warm.slope @ np.array([1.2e-4]))
    found = drift(
        known, replace(data, table=data.table.assign(**dict(zip("xyz", grown.T, strict=True)))), station="known"
    )
    assert found.summary.status in ("conditions", "cannot be told")
    assert found.moved[0].movement == "temperature"


def test_what_moves_points_is_the_graph_s_derivative(robot):
    """Fails if a movement does something else to the points than moving what it names, here by differences."""
    known, q = robot
    data = checked(known, q, 8)
    every = {one.name: one for one in movements(known, data, True)}
    conditions, step = data.stating(known.model.given).conditions, 1e-6
    turned = conditions.copy()
    turned[3] += step
    there = known.model.point(known.estimate, conditions)
    moved = (known.model.point(known.estimate, turned) - there) / step
    np.testing.assert_allclose(every["joint4.zero"].slope[:, :, 0], moved, atol=1e-5)
    turn = every["station"].slope[:, :, 5]
    arm = there - there.mean(axis=0)
    np.testing.assert_allclose(turn, np.cross([0.0, 0.0, 1.0], arm), atol=1e-12)
    assert not any(one.name == "joint2.theta" for one in every.values())  # the same as its zero


def test_what_is_not_told_apart_gets_poses_that_would(robot):
    """Fails if rivals are left without a proposal, or poses are proposed beyond the joints' limits."""
    known, q = robot
    found = drift(known, checked(known, q[:5], 9, zero(5, 4e-4)), station="known")
    assert found.moved
    assert found.next_poses
    limits = np.rad2deg(known.model.robot.limits)
    for one in found.next_poses:
        values = np.array(list(one.readings.values()))
        assert ((values >= limits[:, 0]) & (values <= limits[:, 1])).all()


@pytest.mark.parametrize("size", [3.0, 0.05, 0.005])
@pytest.mark.parametrize("station", ["known", "auto"])
def test_one_mistaken_pose_is_no_movement(robot, size, station):
    """Fails if a pose that alone is off is told as a movement of the robot, with a tiny deviation, and not by its name."""
    known, q = robot
    data = checked(known, q, 7)
    seen = data.position.copy()
    seen[3, 0] += size
    found = drift(known, with_positions(data, seen), station=station)
    assert (found.summary.status, found.moved, found.recalibration) == ("cannot be told", (), ())
    assert any(note.startswith("pose 3, marker E alone carries the error") for note in found.summary.notes)


@pytest.mark.parametrize("seen_by", [1e3, -1.0])
def test_units_and_signs_that_are_wrong_are_no_movement(robot, seen_by):
    """Fails if positions in another unit, or readings with another sign, are told as a movement of metres."""
    known, q = robot
    data = checked(known, q, 8)
    wrong = with_positions(data, data.position * [seen_by, 1, 1])
    found = drift(known, wrong, station="known")
    assert (found.summary.status, found.moved, found.recalibration) == ("cannot be told", (), ())
    assert any("off by more than any calibrated robot" in note for note in found.summary.notes)


def test_what_is_left_beside_a_fitted_frame_is_left_in_the_frame_of_what_is_corrected(robot):
    """Fails if a correction is said to leave more than there was, as the frame had taken up a part of what moved."""
    known, q = robot
    found = drift(known, checked(known, q, 6, zero(2, 4e-4), wrong=False), station="fitted")
    assert [moved.joint for moved in found.moved] == [2]
    assert found.summary.left_mm < 1.8e3 * NOISE
    assert found.summary.left_mm < 0.7 * found.summary.error_mm


def test_a_station_that_moved_between_sessions_is_fitted_there_alone(robot):
    """Fails if the frames of all sessions are fitted or none where the device moved between two, or it is not said in which."""
    known, q = robot
    data = checked(known, q, 9, dates=("mon", "tue"))
    moved = data.position + 0.3 * (data.table["session"] == "tue").to_numpy()[:, None]
    found = drift(known, with_positions(data, moved))
    assert (found.summary.status, found.summary.station) == ("in place", "fitted")
    assert [one for one in found.summary.notes if "was fitted in session 'tue', where it stood elsewhere" in one]
    both = drift(known, with_positions(data, data.position + 0.3))
    assert (both.summary.station, both.summary.status) == ("fitted", "in place")
    judged = validate(known, with_positions(data, moved), tolerance=2e-3).summary
    assert (judged.station, judged.frames, judged.freedom_lost, judged.beyond) == ("fitted", 1, 6, 0)
    assert judged.moved_mm == pytest.approx(300 * 3**0.5, abs=1)
    assert any("than in the calibration in session 'tue': its frame was fitted" in one for one in judged.notes)


def test_a_frame_that_wanders_as_it_did_is_no_drift(robot):
    """Fails if a check hours later takes what the device is known to wander by in that time for something that moved."""
    known, q = robot
    hours, sd = np.full(len(q), 4 * 3600.0), np.full(3, 1e-4)
    wandering = [Later(known.model.robot, "shift", begin=0.0, end=3600.0)]
    later = replace(known, errors=known.errors.with_functions(wandering, sd))
    data = checked(known, q, 7, time=hours, time_origin=0.0)
    elsewhere = replace(data, table=data.table.assign(x=data.table["x"] + 2e-4))
    assert drift(known, elsewhere, station="known").summary.status == "moved"
    assert drift(later, elsewhere, station="known").summary.status == "in place"


def test_what_leaves_most_of_the_error_is_no_correction(robot):
    """Fails if rows of another robot get a shift to add to a reading, as if the calibration were right again then."""
    known, rng = robot[0], np.random.default_rng(0)
    q = candidates(known.model, 60, "load", "E", None, rng)[0]
    frequencies, phases = rng.normal(size=(2, 3, 6))
    data, unlike = checked(known, q, 4), 1e-3 * np.sin(2 * q @ frequencies.T + phases[:, 0])
    turned = np.cross(1e-3 * np.eye(3)[2], data.position)  # as by a zero of joint 1, which explains the lesser part
    found = drift(known, with_positions(data, data.position + turned + unlike), station="known")
    assert found.summary.status == "cannot be told"
    assert not found.moved
    assert not found.recalibration
    assert found.summary.error_mm > 0.2


def with_positions(data, seen):
    """The rows with other measured positions (n, 3) [m]."""
    return replace(data, table=data.table.assign(**dict(zip("xyz", seen.T, strict=True))))


def test_a_smooth_misfit_at_other_poses_is_no_drift():
    """Fails if what a model errs by smoothly counts for each check pose's own error, whose square it is some 14 times."""
    whole, rows = wavering(31, poses=POSES + 40), np.arange(POSES + 40)
    known = calibrated(whole.only(rows < POSES))
    checks = (whole.only((rows >= first) & (rows < first + 8)) for first in range(POSES, len(rows), 8))
    assert np.mean([CheckProblem.of(known, one, "known").square / 24 for one in checks]) < 4


@pytest.mark.parametrize("by", ["station", "effect"])
def test_sessions_that_had_frames_of_their_own_get_one(robot, by):
    """Fails if a device that was set up anew every day, as the calibration knows, is held to its first day's frame."""
    known, q = robot
    model = known.model
    if by == "station":
        seen = Position(Series(station=Station(by_session=True)), still=(("Monday",),))
        anew = replace(known, model=replace(model, observations=(seen,)))
    else:
        apart = build(model.robot, (*model.effects, SessionFrame(model.robot, ("Monday", "Tuesday"))))
        n = len(apart.parameters) - len(known.estimate)
        sure = np.pad(known.covariance, (0, n))
        anew = calibration(apart, np.pad(known.estimate, (0, n)), sure, NOISE)
    data = checked(known, q, 6)
    off = replace(data, table=data.table.assign(x=data.table["x"] + 1e-3, session="Friday"))
    assert validate(known, off).judged.rms_mm > 0.9
    assert validate(anew, off, station="known").judged.rms_mm > 0.9
    assert validate(anew, off).judged.rms_mm < 0.15
    found = drift(anew, off).summary
    assert (found.station, found.status) == ("fitted", "in place")
    for judge in (validate, drift):
        with pytest.raises(InputError, match="session 'Friday' has 2 points"):
            judge(anew, off.only(np.arange(len(off)) < 2))
    assert validate(anew, off.only(np.arange(len(off)) < 2), station="known").judged.rms_mm > 0.9
