"""Chosen poses are poses that the robot can take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.design.planned import SelectionRequest
from calflow.design.selection import select
from calflow.model import build
from calflow.robot.mechanism import reading_columns, shown_readings
from calflow.robot.parts import Coupling
from robots import industrial

LIMITS = np.deg2rad([(-90, 60), (-40, 20), (-10, 80), (-170, 30), (-100, 100), (10, 200)])


def test_chosen_poses_are_inside_the_joints_own_limits():
    """Fails if limits are taken for the reading's where a joint counts the other way or is coupled, or the exchange leaves them."""
    nominal = industrial()
    joints = [replace(joint, limits=tuple(own)) for joint, own in zip(nominal.joints, LIMITS, strict=True)]
    joints[1] = replace(joints[1], sign=-1)
    robot = replace(nominal, joints=tuple(joints), couplings=(Coupling(3, 2, 1.0),))
    poses = select(build(robot, ("geometry",)), SelectionRequest(number=40, candidates=150)).poses
    readings = poses[reading_columns(robot)].to_numpy() / shown_readings(robot, np.ones((1, robot.n_joints)))
    angles = readings.copy()
    angles[:, 1] = -readings[:, 1]
    angles[:, 2] = readings[:, 2] + readings[:, 1]
    assert (angles > LIMITS[:, 0] - 1e-9).all()
    assert (angles < LIMITS[:, 1] + 1e-9).all()
    assert (np.ptp(angles, axis=0) > 0.8 * np.ptp(LIMITS, axis=1)).all()
    assert ((readings < LIMITS[:, 0]) | (readings > LIMITS[:, 1])).any(axis=0)[[1, 2]].all()
