"""How large a curve is said to be over its travel, and others of its kind beyond it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from calflow.effects.cause import Cause
from calflow.effects.joint_error_map import FINEST, JointErrorMap
from calflow.effects.smooth_curve import Travel, waves
from calflow.estimation.extrapolation import Curve
from robots import industrial

LENGTH = 0.15


def kind_of(estimate, variance, usual):
    """A curve of waves whose amplitudes are known each for itself, of variances usual (n,)."""
    return Curve(estimate, np.diag(variance), np.sqrt(usual), 1.0, Travel(0.0, 1.0, 0.1, np.eye(len(usual))))


@pytest.mark.parametrize("size", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("noise", [0.01, 1.0])
def test_a_curve_beyond_its_travel_is_as_large_as_such_curves_are(size, noise):
    """Fails if what the prior takes of amplitudes is missing from what is promised beyond, or few waves are taken for certain."""
    rng, usual = np.random.default_rng(1), np.linspace(2, 0.1, 30)
    variance = usual * noise / (usual + noise)
    sizes = []
    for _ in range(300):
        amplitude = size * np.sqrt(usual) * rng.standard_normal(30)
        seen = amplitude + np.sqrt(noise) * rng.standard_normal(30)
        sizes.append(kind_of(seen * usual / (usual + noise), variance, usual).rms_elsewhere ** 2)
    assert np.sqrt(np.mean(sizes)) == pytest.approx(size, rel=0.25)
    few = [kind_of(np.full(n, 2.0), np.full(n, 1e-6), np.ones(n)).rms_elsewhere ** 2 for n in (3, 300)]
    assert few[0] > 1.3 * few[1] == pytest.approx(1.3 * 4.0, rel=0.05)


def curve_of_sines(rng, size):
    """A curve of an angle [rad], of root mean square size over long travels: twelve sines, alike over about 0.15 rad."""
    rate, phase = rng.standard_t(5, 12) / LENGTH, rng.uniform(0, 2 * np.pi, 12)
    return lambda angle: size * np.sqrt(2 / 12) * np.sin(np.multiply.outer(angle, rate) + phase).sum(axis=-1)


@pytest.mark.parametrize("size", [1e-4, 4e-4])
@pytest.mark.parametrize("gap", [0.0, 0.5])
def test_a_curve_is_as_large_as_it_is_between_its_readings_too(size, gap):
    """Fails if readings that leave gaps make a curve smaller, or surer than they tell; 20 curves over a third of a turn."""
    rng, (low, high), noise = np.random.default_rng(7), (-1.8, -1.8 + 2 * np.pi / 3), 5e-5
    robot = industrial()
    sides = (tuple(np.where(np.arange(robot.n_joints) == 1, side, 0.0)) for side in (low, high))
    cause = Cause(robot, JointErrorMap(robot, *sides, LENGTH), "joint2")
    angle, usual = ca.SX.sym("angle"), np.array([p.prior_sd for p in cause.declared])
    values = ca.vertcat(*(wave.value for wave in waves(angle, low, high, LENGTH, FINEST)))
    basis, everywhere = ca.Function("waves", [angle], [values]), np.linspace(low, high, 2001)
    inside, unsure = [], []
    for _ in range(20):
        reading = rng.uniform(low, high, 1000)
        middle = rng.uniform(low + 0.3, high - 0.3)
        reading = reading[np.abs(reading - middle) > gap * (high - low) / 2][:150]
        curve = curve_of_sines(rng, size)
        seen = curve(reading) + noise * rng.standard_normal(len(reading))
        acting = np.array(basis(reading[None])).T
        covariance = np.linalg.inv(acting.T @ acting / noise**2 + np.diag(usual**-2))
        estimate, sd = Curve.of(cause, covariance @ acting.T @ seen / noise**2, covariance).rms_over_travel
        true = np.sqrt(np.mean(curve(everywhere) ** 2))
        inside.append(abs(estimate - true) < 1.96 * sd)
        unsure.append(sd / true)
    assert sum(inside) >= 17
    assert np.mean(unsure) < (0.4 if gap else 0.1)
