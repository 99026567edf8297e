"""Serial errors: exact whitening at any spacing, and sizes that are likely.

Covariances are written out here as matrices, row by row.
"""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.serial_errors import RestrictedLikelihood, RowOrder, SerialErrors

N = 40
RNG = np.random.default_rng(2)
TIME = np.cumsum(RNG.exponential(size=N))
GROUPS = np.repeat(np.arange(N // 5), 5)


def covariance(order, ratio, length, kept):
    """V, by its definition."""
    apart, groups = np.cumsum(order.gap), np.cumsum(order.begins)
    process = np.exp(-np.abs(np.subtract.outer(apart, apart)) / length) * kept ** np.abs(
        np.subtract.outer(groups, groups)
    )
    return (np.eye(N) + ratio * process) / (1 + ratio)


@pytest.mark.parametrize("groups", [None, GROUPS])
def test_whitening_is_exact(groups):
    """Fails if uneven spacing, groups, or the determinant are approximate."""
    rows, order = RowOrder.sorted(N, TIME, groups)
    assert (rows == np.arange(N)).all()
    figures = np.log([3.0, 2.0, 0.25])[: 2 if groups is None else 3]  # a logit of log(1/4) is 0.2
    errors = SerialErrors(order, figures)
    whole = covariance(order, 3.0, 2.0, 1.0 if groups is None else 0.2)
    whitened = errors.whitened(np.eye(N))
    assert np.abs(whitened @ whole @ whitened.T - np.eye(N)).max() < 1e-10
    assert errors.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1])


def test_likely_figures_are_near_the_true_ones():
    """Fails if restricted likelihood is not what is maximised, or its covariance not how far figures are off: 40 draws of 300."""
    n, misses = 300, []
    _, order = RowOrder.sorted(n)
    for seed in range(40):
        rng = np.random.default_rng([3, seed])
        process = np.zeros(n)
        for k, drawn in enumerate(rng.standard_normal(n)):
            process[k] = np.exp(-1 / 8) * process[k - 1] + np.sqrt(1 - np.exp(-2 / 8)) * drawn if k else drawn
        residual = 2 * process + rng.standard_normal(n)
        found = RestrictedLikelihood(residual, np.ones((n, 1)) * 1e3, np.zeros(1), 2.2, n - 1.0).likeliest(order)
        misses.append((found.figures - np.log([4.0, 8.0])) / np.sqrt(found.covariance.diagonal()))
    assert np.abs(np.mean(misses, axis=0)).max() < 0.8
    assert 0.5 < np.std(misses) < 1.6
