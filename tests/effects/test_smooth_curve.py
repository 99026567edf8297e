"""A smooth curve over an interval."""

from __future__ import annotations

import casadi as ca
import numpy as np

from calflow.effects.base import waves

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
