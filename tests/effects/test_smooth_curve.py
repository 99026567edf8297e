"""A smooth curve over an interval."""

from __future__ import annotations

import casadi as ca
import numpy as np

from calflow.effects.frame_drift import FrameDrift
from calflow.effects.smooth_curve import waves
from calflow.robot.mechanism import Row, name_number
from robots import ur10

LOW, HIGH, LENGTH, FINEST = -1.0, 2.0, 0.4, 0.1


def drawn(places, rng, draws=4000):
    """Curves of variance 1 at these places, shape (draws, n_places)."""
    x = ca.SX.sym("x")
    curve = waves(x, LOW, HIGH, LENGTH, FINEST)
    values = ca.Function("curve", [x], [ca.vertcat(*(wave.value for wave in curve))])
    amplitudes = rng.standard_normal((draws, len(curve))) * [wave.sd for wave in curve]
    return amplitudes @ np.array(values(np.atleast_2d(places)))


def test_inside_it_is_as_large_and_as_smooth_as_stated():
    """Fails if the waves' priors do not make a process of variance 1 whose neighbours are alike as far as the length."""
    curves = drawn([-0.2, -0.2 + LENGTH, -0.2 + 4 * LENGTH], np.random.default_rng(1))
    near, far = np.corrcoef(curves.T)[0, 1:]
    np.testing.assert_allclose(curves.var(axis=0), 1.0, atol=0.1)
    matern = (1 + np.sqrt(5) + 5 / 3) * np.exp(-np.sqrt(5))
    np.testing.assert_allclose([near, far], [matern, 0.0], atol=0.06)


def test_beyond_the_interval_nothing_is_told():
    """Fails if a curve goes on where nothing was measured: the mirror image of what was."""
    beyond = [LOW - 0.16, LOW - 1.0, HIGH + 0.16, HIGH + 1.0]
    np.testing.assert_allclose(drawn(beyond, np.random.default_rng(2), draws=50), 0.0, atol=1e-12)


def test_a_device_that_wandered_stands_on_average_in_another_session_and_later():
    """Fails if a curve in time goes on in rows not measured meanwhile, or if its mean could be the station's as well as its own."""
    robot = ur10()
    drift = FrameDrift(robot, sessions=("monday",), length=0.5, end=100.0)
    row, p = Row.symbols(robot, ("time", "session")), ca.SX.sym("p", len(drift.declared))
    moved = ca.Function("moved", [p, row.time, row.session], [drift.device(p, ca.SX.zeros(3), row)])
    waved = np.random.default_rng(3).standard_normal(p.numel())

    def at(time: float, session: str) -> np.ndarray:
        return np.array(moved(waved, time, name_number(session))).ravel()

    meanwhile = np.array([at(time, "monday") for time in np.linspace(0.05, 99.95, 1000)])
    assert (meanwhile.std(axis=0) > 0.1).all()
    np.testing.assert_allclose(meanwhile.mean(axis=0), 0.0, atol=1e-3 * meanwhile.std())
    np.testing.assert_allclose([at(50.0, "tuesday"), at(105.1, "monday")], 0.0, atol=1e-12)
    np.testing.assert_allclose(at(100.01, "monday"), at(100.0, "monday"), atol=0.01 * meanwhile.std())
