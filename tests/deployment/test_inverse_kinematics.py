"""Inverse kinematics: readings that land on the targets, change least, keep to the limits, and own up to what is out of reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.deployment.compensation import clearance
from calflow.deployment.inverse_kinematics import Targets, landing, nominal_readings
from calflow.deployment.prediction import beyond_limits
from calflow.design.candidates import candidates
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from robots import hh800, industrial, ur10
from robots import rows as packed


@pytest.fixture(params=[ur10, hh800], ids=["serial", "loop"])
def wrong(request):
    """A model with large errors, its parameters, and readings whose nominal positions are the targets."""
    robot = request.param()
    model = build(robot, ("geometry", "joint-compliance"))
    rng = np.random.default_rng(3)
    p = np.clip(model.nominal + 0.3 * model.prior_sd * rng.standard_normal(len(model.nominal)), *model.bounds.T)
    readings, conditions = candidates(model, 12, next(iter(robot.payloads)), next(iter(robot.markers)), None, rng)
    return model, p, readings, conditions, model.point(model.nominal, conditions)


def test_it_lands_where_it_is_told(wrong):
    """Fails if the true position at the readings is not the target, here by the model's own positions."""
    model, p, readings, rows, targets = wrong
    before = np.linalg.norm(model.point(p, rows) - targets, axis=1)
    found = landing(model, p, rows, Targets(targets), readings)
    there = np.vstack([found.readings.T, rows[model.robot.n_joints :]])
    assert before.max() > 1e-3
    assert found.reached.all()
    np.testing.assert_allclose(model.point(p, there), targets, atol=1e-8)


def test_of_all_readings_that_land_it_takes_the_nearest(wrong):
    """Fails if the change is larger than it must be: at its end it has no part along which the tool stands still."""
    model, p, readings, rows, targets = wrong
    found = landing(model, p, rows, Targets(targets), readings)
    n, step = model.robot.n_joints, 1e-6
    for k, (moved, start) in enumerate(zip(found.readings, readings, strict=True)):
        around = np.hstack([moved[:, None] + step * np.eye(n), moved[:, None] - step * np.eye(n)])
        points = model.point(p, np.vstack([around, np.tile(rows[n:, k : k + 1], 2 * n)]))
        slope = (points[:n] - points[n:]).T / (2 * step)
        mixed = model.robot.reading_matrix
        change, slope = mixed @ (moved - start), slope @ np.linalg.inv(mixed)
        low, high = model.robot.limits.T
        q = mixed @ moved
        if ((q < low + 1e-6) | (q > high - 1e-6)).any():
            continue  # a joint at its limit leaves the others more to do
        still = change - np.linalg.pinv(slope) @ (slope @ change)
        assert np.abs(still).max() < 1e-3 * np.abs(change).max() + 1e-7


def test_without_a_start_it_finds_one_within_the_limits(wrong):
    """Fails if a target within reach is not found, a limit is passed, or one out of reach counts as reached."""
    model, p, _, rows, targets = wrong
    targets = targets.copy()
    targets[0] = [30.0, 0.0, 0.0]
    start, common = nominal_readings(model, rows, Targets(targets), np.random.default_rng(1))
    assert not common[0]
    found = landing(model, p, rows, Targets(targets), start)
    assert not found.reached[0]
    assert found.away[0] > 20
    assert found.reached[1:].sum() >= 10
    q = found.readings @ model.robot.reading_matrix.T
    low, high = model.robot.stops.T
    assert ((q >= low - 1e-8) & (q <= high + 1e-8)).all()


@pytest.mark.parametrize("arm", [ur10, industrial], ids=["ur10", "industrial"])
def test_without_a_start_the_arm_does_not_turn_over(arm):
    """Fails if neighbouring targets get different postures where one reaches them all, whatever their order in the file."""
    robot = arm()
    model = Model(robot, ())
    middle = np.deg2rad(
        [20.0, -70.0, 80.0, -60.0, -70.0, 30.0] if arm is ur10 else [20.0, 10.0, 10.0, 30.0, 60.0, 30.0]
    )
    row = packed(model, middle[None])
    offsets = np.stack(np.meshgrid(*3 * [np.linspace(-0.12, 0.12, 5)]), axis=-1).reshape(-1, 3)
    order = np.random.default_rng(7).permutation(len(offsets))
    place = (model.point(np.zeros(0), row) + offsets)[order]
    turned = np.repeat(model.rotation(np.zeros(0), row), len(order), axis=0)
    start, common = nominal_readings(
        model, np.repeat(row, len(order), 1), Targets(place, turned), np.random.default_rng(7)
    )
    assert common.all()
    lined_up = start[np.argsort(order)].reshape(5, 5, 5, 6)
    assert max(np.abs(np.diff(lined_up, axis=axis)).max() for axis in range(3)) < np.deg2rad(30)


def test_a_joint_without_limits_turns_on():
    """Fails if a joint that nobody limits is taken to end at half a turn: it would be turned all the way back, or not get there."""
    joints = tuple(replace(joint, limits=None if i == 5 else (-3.1, 3.1)) for i, joint in enumerate(ur10().joints))
    model = build(replace(ur10(), joints=joints), ("geometry",))
    start = np.deg2rad([[10.0, -80.0, 90.0, -100.0, -80.0, 250.0], [10.0, -80.0, 90.0, -100.0, -80.0, -900.0]])
    conditions = Measurements.from_arrays(model.robot, start, None, payload="load").stating(()).conditions
    there = Targets(model.point(model.nominal, conditions) + 1e-3, model.rotation(model.nominal, conditions))
    found = landing(model, model.nominal, conditions, there, start)
    assert found.reached.all()
    assert np.abs(found.readings - start).max() < 0.05
    clear = clearance(model, np.vstack([found.readings.T, conditions[6:]]), oriented=True)
    assert set(clear.joint) <= set(range(5))
    assert np.isfinite(clear.limit).all()
    assert beyond_limits(Measurements.from_arrays(model.robot, start, None, payload="load")) == []


def test_a_joint_at_its_limit_leaves_the_rest_to_the_others():
    """Fails if a limit makes a target unreachable that other joints could reach."""
    robot = ur10()
    model = build(robot, ("geometry",))
    readings, conditions = candidates(model, 1, "load", "E", None, np.random.default_rng(5))
    joints = tuple(
        joint if k else replace(joint, limits=(readings[0, 0] - 1e-3, readings[0, 0]))
        for k, joint in enumerate(robot.joints)
    )
    bound = build(replace(robot, joints=joints), ("geometry",))
    turned = readings + np.array([0.02, 0, 0, 0, 0, 0])  # only beyond joint 1's limit by itself
    target = model.point(model.nominal, np.vstack([turned.T, conditions[6:]]))
    found = landing(bound, bound.nominal, conditions, Targets(target), readings)
    assert found.reached.all()
    assert found.readings[0, 0] <= readings[0, 0] + 1e-8
    assert np.abs(found.readings - turned).max() > 1e-3
