"""Joint compliance: the pose in which springs and loads balance."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.design.candidates import packed_conditions
from calflow.effects.joint_compliance import JointCompliance
from calflow.model import build
from calflow.robot.mechanism import rated_torques
from calflow.robot.robot import Robot

PAPER = np.array([0, 1.792e-7, 1.915e-7, 1.959e-7, 1.820e-7, 0])  # rad/Nm, the paper's s2 to s5
ROBOTS = {
    "hh800": (robots.hh800(), "rated", PAPER),
    "hh800 other bars": (robots.hh800_with_bars(0.75, 1.7, 0.9), "rated", PAPER),
    "ur10": (robots.ur10(), "load", np.array([1.0, 2.0, 3.0, 8.0, 8.0, 8.0]) * 1e-5),
    "industrial": (robots.industrial(), "load", np.array([0.1, 0.3, 0.4, 2.0, 2.0, 2.0]) * 1e-6),
}


def equilibrium(robot: Robot, q: np.ndarray, payload: str, s: np.ndarray) -> np.ndarray:
    """Driven angles (n_rows, n) at which all springs balance their loads: fixed point, until it stands."""
    at = q
    for _ in range(40):
        before, at = at, q - s * robots.holding_torque(robot, at, payload)
        if np.abs(at - before).max() < 1e-12:
            return at
    raise AssertionError("no equilibrium")


@pytest.mark.parametrize("name", ROBOTS)
def test_position_is_that_of_the_equilibrium(name: str) -> None:
    """Breaks if a spring turns the wrong way, or the loads are not taken at the deflected pose."""
    robot, payload, s = ROBOTS[name]
    q = robots.poses(robot, 60)
    model = build(robot, ["joint-compliance"])
    found = model.position(s, robots.rows(model, q, payload))
    wanted = robots.marker_position(robot, equilibrium(robot, q, payload, s))
    assert np.linalg.norm(found - wanted, axis=1).max() < 1e-6

    sag = np.linalg.norm(wanted - robots.marker_position(robot, q), axis=1)
    assert sag.max() > 1e-3
    once = q - s * robots.holding_torque(robot, q, payload)
    short = np.linalg.norm(robots.marker_position(robot, once) - wanted, axis=1)
    assert short.max() > 5e-6  # so one evaluation at the commanded pose would be told apart


def test_payload_bends_the_robot() -> None:
    """Breaks if a row without payload carries one, or the row's payload is ignored."""
    robot, _, s = ROBOTS["hh800"]
    model, q = build(robot, ["joint-compliance"]), robots.poses(robot, 20)
    free = model.position(s, robots.rows(model, q))
    assert_allclose(free, robots.marker_position(robot, equilibrium(robot, q, "", s)), atol=1e-6)
    assert np.linalg.norm(free - model.position(s, robots.rows(model, q, "rated")), axis=1).min() > 1e-4


def test_wrong_lengths_move_the_masses_too() -> None:
    """Breaks if torques are those of the nominal robot while the figures are corrected."""
    robot, payload, s = ROBOTS["hh800"]
    model = build(robot, ["joint-compliance", "geometry"])
    names = [parameter.name for parameter in model.parameters]
    assert names[:6] == [f"joint{i}.s" for i in range(1, 7)]
    longer = robots.hh800_with_bars(crank=0.81)
    p = np.concatenate([s, 0.01 * (np.array(names[6:]) == "loop.crank")])
    q = robots.poses(robot, 20)
    wanted = robots.marker_position(longer, equilibrium(longer, q, payload, s))
    assert_allclose(model.position(p, robots.rows(model, q, payload)), wanted, atol=1e-6)


def test_measured_torques_wind_the_springs_up() -> None:
    """Breaks if measured motor torques are ignored or turn the joints against the load."""
    robot, payload, s = ROBOTS["ur10"]
    model = build(robot, ["joint-compliance"], given=("torque",))
    q = robots.poses(robot, 10)
    measured = np.random.default_rng(7).normal(scale=50, size=q.shape)
    conditions = packed_conditions(model, q, payload, "E")
    conditions[-6:] = measured.T
    assert_allclose(model.position(s, conditions), robots.marker_position(robot, q - s * measured), atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_prior_is_on_the_windup_at_rated_torque(name: str) -> None:
    """Breaks if a spring may push, or a big joint's spring is expected as soft as a small one's."""
    robot = ROBOTS[name][0]
    springs = JointCompliance(robot).parameters()
    assert [spring.name for spring in springs] == [f"joint{i}.s" for i in range(1, 7)]
    windup = np.array([spring.prior_sd for spring in springs]) * rated_torques(robot)
    assert_allclose(windup, windup[0])
    assert 1e-3 < windup[0] < 0.1
    for spring in springs:
        assert spring.lower == spring.nominal == 0 < 3 * spring.prior_sd < spring.upper


@pytest.mark.parametrize("name", ROBOTS)
def test_derivatives_equal_central_differences(name: str) -> None:
    """Breaks if the derivative forgets that the loads change with the deflected pose."""
    robot, payload, s = ROBOTS[name]
    model = build(robot, ["joint-compliance"])
    conditions = robots.rows(model, robots.poses(robot, 5), payload)
    jacobian = model.position_jacobian(s, conditions)
    for k, step in enumerate(np.diag(np.full(6, 1e-3 * s.max()))):
        wanted = (model.position(s + step, conditions) - model.position(s - step, conditions)) / (2 * step.max())
        assert_allclose(jacobian[:, :, k], wanted, atol=1e-6 * max(np.abs(wanted).max(), np.abs(jacobian).max() * 1e-2))
