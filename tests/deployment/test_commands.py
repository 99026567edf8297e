"""Commands: they land where the calibrated model has it, from the side they come from, and own up to what is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.deployment.compensation import (
    TargetFrameTable,
    clearance,
    compensate_rows,
    not_known,
    targets_in_measuring_frame,
)
from calflow.deployment.inverse_kinematics import Targets
from calflow.estimation.needed_conditions import needed_conditions
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.observations.pose import Pose
from calflow.robot.parts import Base
from deployment.test_needed_conditions import PLAY, calibrated, sides
from robots import ASKEW

WRONG = {"joint2.theta": 1e-3, "joint3.alpha": 2e-3, "joint4.a": 5e-4, "base.x": 1e-3, "base.rz": 1e-3}


def angle(first, second):
    """The angles between rotations (n, 3, 3) [rad]."""
    cosine = (np.einsum("nij,nij->n", first, second) - 1) / 2
    return np.arccos(np.clip(cosine, -1, 1))


@pytest.fixture(scope="module")
def posed():
    """A robot with errors, and the poses that its nominal self has at some readings away from the limits."""
    known, data = calibrated(("geometry",), WRONG)
    data = data.only(np.abs(data.joints).max(axis=1) < 3.0)
    model, conditions = known.model, data.conditions
    return known, data, Targets(model.point(model.nominal, conditions), model.rotation(model.nominal, conditions))


def test_a_pose_is_met_in_place_and_orientation(posed):
    """Fails if the tool lands beside its target, turned otherwise, or what the nominal command misses by is not told."""
    known, data, targets = posed
    found = compensate_rows(known, data, targets, start=data.joints)
    there = np.vstack([found.readings.T, data.conditions[6:]])
    on = found.reached
    assert on.mean() > 0.9
    np.testing.assert_allclose(known.model.point(known.estimate, there)[on], targets.position[on], atol=2e-6)
    assert angle(known.model.rotation(known.estimate, there), targets.rotation)[on].max() < 1e-5
    before = known.model.point(known.estimate, data.conditions) - targets.position
    np.testing.assert_allclose(found.nominal_miss, np.linalg.norm(before, axis=1), atol=1e-12)
    assert found.nominal_turned.max() > 1e-3
    assert found.turn_sd.shape == (len(data), 3)


def test_poses_are_reached_without_a_start(posed):
    """Fails if a sampled inverse misses poses that are within reach, or leaves the limits."""
    known, data, targets = posed
    few = np.arange(10)
    found = compensate_rows(known, data.only(np.isin(np.arange(len(data)), few)), targets.only(few))
    low, high = known.model.robot.stops.T
    assert found.reached.all()
    assert ((found.readings >= low - 1e-8) & (found.readings <= high + 1e-8)).all()


def test_what_is_out_of_reach_is_named_and_the_rest_done(posed):
    """Fails if one target out of reach takes others with it, is passed over, or is named once for each move to it."""
    known, data, targets = posed
    position = targets.position.copy()
    position[3:5] = [9.0, 0.0, 0.0]
    names = [f"P{min(k, 3)}" for k in range(len(data))]
    found = compensate_rows(
        known, replace(data, table=data.table.assign(pose=names)), Targets(position), start=data.joints
    )
    assert list(np.flatnonzero(~found.reached)) == [3, 4]
    assert "2 of" in found.notes[0]
    assert found.notes[0].endswith("out of reach within the joint limits (29 starts tried): pose P3")
    assert found.remaining[3] > 5


def test_what_one_start_does_not_lead_to_is_not_called_out_of_reach(posed):
    """Fails if a target that other readings lead to counts as out of reach since the way from the given ones gets stuck."""
    known, data, targets = posed
    few = np.arange(24)
    data, targets = data.only(np.isin(np.arange(len(data)), few)), targets.only(few)
    near = compensate_rows(known, data, targets, start=data.joints)
    found = compensate_rows(known, data, targets, start=np.roll(data.joints, 1, axis=0))
    stuck = near.reached & ~found.reached
    assert stuck.sum() >= 2
    beyond = [note for note in found.notes if "out of reach" in note]
    told = next(note for note in found.notes if "not reached from the readings given, but from others" in note)
    assert int(told.split(" of ")[0]) >= 0.8 * stuck.sum()
    assert sum(int(note.split(" of ")[0]) for note in beyond) + int(told.split(" of ")[0]) == (~found.reached).sum()


def test_backlash_is_taken_by_the_direction_of_the_commands():
    """Fails if the play is taken from the wrong side, or left out: some 2.5 mm at the tool."""
    known, measured = calibrated(("geometry", "joint-backlash"), {"joint1.joint-backlash.b": PLAY}, approach=sides())
    robot = known.model.robot
    known = replace(known, needed=needed_conditions(known.model, known.estimate, measured))
    data = Measurements.from_arrays(robot, measured.joints, None, payload="load")
    model = replace(known.model, given=())
    targets = Targets(model.point(known.estimate, data.conditions))
    with pytest.raises(InputError, match="joint-backlash"):
        compensate_rows(known, data, targets, start=data.joints)
    found = compensate_rows(known, data, targets, start=data.joints, in_order=True)
    came = np.vstack([np.zeros(6), np.sign(np.diff(found.readings, axis=0))])
    there = Measurements.from_arrays(robot, found.readings, None, payload="load", approach=came)
    sided = replace(known.model, given=there.given)
    np.testing.assert_allclose(sided.point(known.estimate, there.conditions), targets.position, atol=2e-6)
    assert np.abs(found.readings - data.joints)[1:].max() == pytest.approx(PLAY / 2, rel=0.2)
    assert found.nominal_miss.max() > 1e-3


def test_what_nobody_measured_of_the_orientation_is_said(posed):
    """Fails if a turn that only a prior knows is promised as if measured, or doubted where orientations were measured."""
    known, data, _ = posed
    names = [parameter.name for parameter in known.model.parameters]
    free = np.diag(np.where(np.array(names) == "joint6.theta", known.model.prior_sd**2, 1e-12))
    one = replace(known, covariance=free)
    first, second = not_known(one, data.conditions)
    assert "no orientation was measured" in first
    assert "about its own z counts as known to 2 mrad, an assumption" in second
    assert len(not_known(known, data.conditions)) == 1
    seen = replace(one, model=replace(one.model, observations=(Pose(Series()),)))
    assert not_known(seen, data.conditions) == []


def test_a_target_may_be_in_the_base_or_in_a_fixture():
    """Fails if a frame is applied the wrong way round, or the base is taken where the robot file has it."""
    known, data = calibrated(("geometry",), {"base.x": 0.01})
    robot = replace(known.model.robot, base=Base(origin=ASKEW.origin, rotation=(0.0, 0.0, np.pi / 2)))
    known = replace(known, model=replace(known.model, robot=robot))
    asked = Targets(np.tile([1.0, 0.0, 0.0], (3, 1)))
    fixture = {"fixture": TargetFrameTable(origin_m=[0.5, 0.0, 0.0], rotation_deg=[0.0, 0.0, 90.0], within="base")}
    conditions = data.conditions[:, :3]
    found = targets_in_measuring_frame(asked, ["base", "fixture", ""], fixture, known, conditions)
    origin = ASKEW.origin
    np.testing.assert_allclose(found.position[0], np.add(origin, (0.0, 1.01, 0.0)), atol=1e-12)
    np.testing.assert_allclose(found.position[1], np.add(origin, (-1.0, 0.51, 0.0)), atol=1e-12)
    np.testing.assert_array_equal(found.position[2], asked.position[2])
    with pytest.raises(InputError, match=r"unknown frame 'fixtur'.*did you mean 'fixture'"):
        targets_in_measuring_frame(asked, ["fixtur"] * 3, fixture, known, conditions)


def test_the_distance_to_a_wrist_singularity_is_joint_5_s_angle(posed):
    """Fails if a wrist that is nearly stretched counts as far from singular, or the nearest limit is another joint's."""
    known, data, _ = posed
    q = np.tile([0.3, -1.2, 1.4, -0.9, 0.0, 0.2], (2, 1))
    q[:, 4] = np.deg2rad([3.0, -8.0])
    q[1, 5] = np.pi - 0.01
    conditions = np.vstack([q.T, data.conditions[6:, :2]])
    joints = tuple(replace(joint, limits=(-np.pi, np.pi)) for joint in known.model.robot.joints)
    found = clearance(replace(known.model, robot=replace(known.model.robot, joints=joints)), conditions, oriented=True)
    np.testing.assert_allclose(np.rad2deg(found.singular), [3.0, 8.0], rtol=0.05)
    assert found.joint[1] == 5
    assert found.limit[1] == pytest.approx(0.01)
