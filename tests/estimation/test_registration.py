"""A robot that stands anywhere is found from the training poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.estimation.registration import registered
from calflow.model import build
from calflow.observations import observations
from calflow.robot.parts import Base, Marker
from estimation.data import measured
from robots import industrial


@pytest.mark.parametrize("angles", [(170, 20, -100), (0, 90, 45), (-120, -60, 10)])
def test_base_and_tool_are_found(angles):
    """Fails for a tracker that stands on its head, beside a singular angle, or far away."""
    rng = np.random.default_rng(18)
    robot = industrial()
    stands = Base(origin=(12.0, -7.0, 2.0), rotation=np.deg2rad(angles))
    name = next(iter(robot.markers))
    moved = Marker(point=tuple(np.add(robot.markers[name].point, (0.02, -0.03, 0.05))))
    real = build(replace(robot, base=stands, markers={name: moved}), ())
    data = measured(real, real.nominal, 40, rng)
    found, _ = registered(replace(robot, base=Base(known=False)), observations(data), data)
    np.testing.assert_allclose(found.base.origin, stands.origin, atol=1e-4)
    turn = Rotation.from_euler("XYZ", found.base.rotation).inv() * Rotation.from_euler("XYZ", stands.rotation)
    assert turn.magnitude() < 1e-4
    np.testing.assert_allclose(found.markers[name].point, moved.point, atol=1e-4)


def test_a_known_base_stays():
    """Fails if a base that the robot file states is moved."""
    robot = industrial()
    data = measured(build(robot, ()), build(robot, ()).nominal, 10, np.random.default_rng(19))
    assert registered(robot, observations(data), data)[0] is robot
