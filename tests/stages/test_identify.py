"""The settled fit keeps its statistical promises where repeats, discrepancies and outliers meet."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.accuracy import errors
from calflow.estimation.fit import fit, fit_reweighted
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.files.units import METRE
from calflow.model import build
from calflow.sampling.log_posterior import Laplace
from estimation.data import SIGMA, drawn_truth, measured, stated
from robots import industrial


@pytest.fixture(scope="module")
def model():
    return build(industrial(), ("geometry",))


def test_repeats_and_discrepancy_leave_honest_deviations(model):
    """Fails if ten repeats of a wrong model count as ten pieces of evidence: deviations would be three times too small."""
    rng = np.random.default_rng(30)
    z = []
    for _ in range(6):
        truth = drawn_truth(model, rng)
        data = measured(model, truth, 50, rng, repeats=10)
        data.table[["x", "y", "z"]] += (1e-4 * rng.standard_normal((50, 3)))[data.table["pose"]]
        result = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")[0]
        z.append((result.estimate - truth) / np.sqrt(np.diag(result.covariance)))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.2)


def test_a_robust_fit_stays_robust(model):
    """Fails if outliers return through the refit, the discrepancy or the posterior."""
    rng = np.random.default_rng(31)
    truth = drawn_truth(model, rng)
    data = measured(model, truth, 60, rng)
    data.table.loc[:2, ["x", "y", "z"]] += 2e-2
    result, level, *_ = fit_reweighted(model, data, stated(data), model.nominal[None], "cauchy")
    assert level.discrepancy[METRE] < SIGMA
    probe = measured(model, truth, 50, rng, sigma=0.0)
    assert np.linalg.norm(model.position(result.estimate, probe.conditions) - probe.position, axis=1).mean() < 2 * SIGMA
    weighed = LeastSquares.of(model, data, level).reweighted(result.estimate, "cauchy")
    sampled = Laplace.of(weighed, result.estimate)
    assert sampled.variance < 2
    again, _ = fit(weighed)
    assert np.linalg.norm(model.position(again.estimate, probe.conditions) - probe.position, axis=1).mean() < 2 * SIGMA


def test_residuals_are_whitened_by_the_noise_that_is_returned(model):
    """Breaks if a noise that has settled, but not to the last digit, is another one than that of residuals and covariance."""
    rng = np.random.default_rng(7)
    data = measured(model, drawn_truth(model, rng), 60, rng)
    level = Noise(np.full(len(data), 1.3 * SIGMA), ("estimated",))
    result, noise, _, _ = fit_reweighted(model, data, level, model.nominal[None], "linear", tolerance=0.5)
    error = errors(model, result.estimate, data)
    assert result.residual.reshape(-1, 3) * noise.sigma[:, None] == pytest.approx(error, abs=1e-12)
    freedom = result.residual.size - result.effective_parameters
    assert (result.residual**2).sum() / freedom == pytest.approx(1.0, abs=0.02)
