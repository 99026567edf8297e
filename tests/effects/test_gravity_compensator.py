"""Gravity compensator: its torque is the slope of its energy, wherever its hinges are, whatever drives it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.effects.gravity_compensator import GravityCompensator
from calflow.effects.warming import REFERENCE
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered
from calflow.robot.mechanism import Row, State

DISTANCE = 0.5  # m, of the hinge on the column
Q = np.linspace(-1.5, 1.5, 40)


def torque(effect: GravityCompensator, p: np.ndarray, kelvin: float = REFERENCE) -> np.ndarray:
    """The torque on joint 2 at its angles Q [Nm]."""
    state, row = State.symbols(effect.robot), Row.symbols(effect.robot)
    of = ca.Function("torque", [state.q, row.temperature], [effect.torque(ca.DM(p), state, row)])
    angles = np.zeros((effect.robot.n_joints, len(Q)))
    angles[1] = Q
    return np.array(of(angles, kelvin))[1]


def slope(effect: GravityCompensator, preload: float, rate: float) -> np.ndarray:
    """Minus the energy's derivative by joint 2's angle, of a spring that pulls between two points in the joint's plane."""

    def energy(q: np.ndarray) -> np.ndarray:
        arm = effect.ratio * DISTANCE * np.exp(1j * (q - effect.upright - np.deg2rad(effect.hinge)))
        length = np.abs(arm + DISTANCE)
        return preload * length + rate * length**2 / 2

    step = 1e-5
    return -(energy(Q + step) - energy(Q - step)) / (2 * step)


@pytest.mark.parametrize("hinge", [0.0, 37.0, -120.0])
@pytest.mark.parametrize("rate", [0.0, 2e4])
def test_torque_is_the_slope_of_a_springs_energy(hinge: float, rate: float) -> None:
    """Breaks if a cylinder's or a spring's torque is none of any constant force and rate, or the hinge turns the wrong way."""
    effect = GravityCompensator(robots.industrial(), 0.3, hinge, spring=rate > 0)
    wanted = slope(effect, 3e3, rate)
    basis = np.array([torque(effect, p) for p in np.eye(len(effect.parameters()))]).T
    found = np.linalg.lstsq(basis, wanted, rcond=None)[0]
    assert np.abs(wanted).max() > 100
    assert_allclose(basis @ found, wanted, atol=1e-5)


def test_a_gas_pushes_as_much_harder_as_it_is_warmer() -> None:
    """Breaks if a gas's force does not go with its absolute temperature, or a spring's does."""
    robot, p = robots.industrial(), np.array([100.0, 50.0])
    cold, warm = (torque(GravityCompensator(robot, gas=True), p, kelvin) for kelvin in (REFERENCE, 1.05 * REFERENCE))
    assert_allclose(warm, 1.05 * cold)
    assert_allclose(torque(GravityCompensator(robot), p, 1.05 * REFERENCE), cold)


def test_hinges_between_those_tried_are_reached() -> None:
    """Breaks if a hinge's direction or distance is out of reach, or a gas is tried where nobody measured temperatures."""
    robot = robots.industrial()
    table = {name: np.linspace(-1, 1, 40) for name in numbered("q", robot.n_joints)}
    data = Measurements(robot, pd.DataFrame(table))
    tried = GravityCompensator.variants(robot, data)
    finer = [near for one in tried for near in one.finer(data) if near.ratio]
    angles = np.unique([one.hinge for one in finer])
    assert np.diff(angles).max() <= 45
    assert (angles.min(), angles.max()) == (-180, 180)
    assert {one.ratio for one in finer} >= {0.15, 0.25, 0.4, 0.6}
    assert not any(one.gas for one in finer)
    warm = Measurements(robot, pd.DataFrame(table | {"temperature": np.linspace(290, 300, 40)}))
    assert {one.gas for variant in tried for one in variant.finer(warm)} == {False, True}
