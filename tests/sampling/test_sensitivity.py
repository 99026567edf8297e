"""Power scaling: its weights and distances against normal densities, and what it says of a real robot's parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from calflow.sampling.posterior import ALPHAS, power_weights, sensitivity, told_by_prior

CHAINS, DRAWS = 40, 2000


def scaled(alpha, beta, prior, likelihood):
    """Mean and sd of the product of two normals (mean, sd), raised to the powers alpha and beta."""
    precisions = np.array([alpha / prior[1] ** 2, beta / likelihood[1] ** 2])
    return precisions @ [prior[0], likelihood[0]] / precisions.sum(), precisions.sum() ** -0.5


def drawn(prior, likelihood, seed):
    """Independent draws of the posterior of two normals, and the logs of the two."""
    mean, sd = scaled(1, 1, prior, likelihood)
    values = mean + sd * np.random.default_rng(seed).standard_normal((CHAINS, DRAWS))
    return values, norm.logpdf(values, *prior), norm.logpdf(values, *likelihood)


def distance(first, second, low, high):
    """The cumulative Jensen-Shannon distance of two normals (mean, sd) over a range, the larger of both directions."""
    x = np.linspace(low, high, 100_001)
    found = []
    for sign in (1, -1):
        p, q = (norm.cdf(x, sign * mean, sd) for mean, sd in (first, second))
        middle = (p + q) / 2
        parts = [a * np.log2(a / middle, out=np.zeros_like(a), where=a > 0) + (middle - a) / np.log(2) for a in (p, q)]
        found.append(np.sqrt(np.trapezoid(sum(parts), x) / np.trapezoid(p + q, x)))
        x = -x[::-1]
    return max(found)


@pytest.mark.parametrize("alpha", [0.8, 0.99, 1.01, 1.25])
def test_weighted_draws_are_of_the_scaled_posterior(alpha):
    """Fails if the exponent is wrong, as alpha in place of alpha - 1, or the weights do not add up to 1."""
    prior, likelihood = (0.0, 1.0), (1.5, 1.0)
    values, log_prior, log_likelihood = drawn(prior, likelihood, 1)
    for density, powers in ((log_prior, (alpha, 1)), (log_likelihood, (1, alpha))):
        weights = power_weights(density, alpha)
        assert weights.sum() == pytest.approx(1)
        mean = (weights * values).sum()
        sd = np.sqrt((weights * (values - mean) ** 2).sum())
        expected, unscaled = scaled(*powers, prior, likelihood), scaled(1, 1, prior, likelihood)
        # what is left is the draws' own error, which the weights do not add to
        assert mean - values.mean() == pytest.approx(expected[0] - unscaled[0], abs=0.003)
        assert sd / values.std() == pytest.approx(expected[1] / unscaled[1], abs=0.003)


@pytest.mark.parametrize(("prior_sd", "likelihood_sd"), [(1.0, 100.0), (1.0, 1.0), (10.0, 0.1), (1.0, 0.5)])
@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_sensitivity_is_the_one_of_normal_densities(prior_sd, likelihood_sd, shift):
    """Fails if prior and likelihood are mixed up, or the distance is not per log2 of the power."""
    prior, likelihood = (0.0, prior_sd), (shift, likelihood_sd)
    values, *densities = drawn(prior, likelihood, 2)
    posterior = scaled(1, 1, prior, likelihood)
    for density, powers in zip(densities, (lambda a: (a, 1), lambda a: (1, a)), strict=True):
        exact = [
            distance(posterior, scaled(*powers(alpha), prior, likelihood), values.min(), values.max())
            / abs(np.log2(alpha))
            for alpha in ALPHAS
        ]
        assert sensitivity(values[..., None], density)[0] == pytest.approx(np.mean(exact), abs=0.005)


def test_what_the_data_do_not_tell_is_the_priors(arm):
    """Fails if the upright first joint's compliance, which no weight winds up, is taken for measured, or others for a prior."""
    table = arm.table.set_index("parameter")
    told = set(table.index[told_by_prior(table)[0]])
    assert "joint1.s" in told  # nothing turns the first joint
    assert "joint6.theta" in told  # the last joint's zero and the marker's place are one turn
    measured_well = ["base.x", "joint2.a", "joint3.a", *(f"joint{i}.s" for i in range(2, 7)), "noise.factor"]
    assert not told & set(measured_well)
    assert (table.loc[measured_well, "prior_sensitivity"] < 0.03).all()
