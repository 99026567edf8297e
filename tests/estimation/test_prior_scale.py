"""The scale of priors, held against fits of a linear model in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calflow.estimation.prior_scale import SCALES, by_scale, strays
from calflow.model import build
from robots import ur10

N, NOISE = 5, 0.3


def fitted(design: np.ndarray, seen: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of parameters given data, by least squares with the prior as further rows."""
    rows = np.concatenate([design / NOISE, np.diag(1 / sd)])
    covariance = np.linalg.inv(rows.T @ rows)
    return covariance @ rows.T @ np.concatenate([seen / NOISE, mean / sd]), covariance


def case(seed: int, n_rows: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    mean, sd = rng.standard_normal(N), np.array([1e-3, 1.0, 50.0, 0.2, 3.0])
    design = rng.standard_normal((n_rows, N)) / sd
    return design, design @ mean + rng.standard_normal(n_rows), mean, sd


@pytest.mark.parametrize("n_rows", [3, 40])
def test_each_scale_is_a_fit_with_its_priors(n_rows):
    """Fails if a scale's mean, covariance or probability is not that of a fit, and its evidence, with the priors so scaled."""
    design, seen, mean, sd = case(1, n_rows)
    scaled = np.array([True, True, False, True, True])
    probable, *found = by_scale(*fitted(design, seen, mean, sd), (mean, sd), scaled)
    evidence = []
    for scale, at, spread in zip(SCALES, *found, strict=True):
        own = np.where(scaled, scale, 1.0) * sd
        estimate, covariance = fitted(design, seen, mean, own)
        np.testing.assert_allclose((at - estimate) / sd, 0.0, atol=1e-8)
        np.testing.assert_allclose(spread / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=1e-8)
        marginal = design * own @ (design * own).T + NOISE**2 * np.eye(n_rows)
        evidence.append(multivariate_normal.logpdf(seen, design @ mean, marginal))
    weight = np.exp(np.array(evidence) - max(evidence))
    np.testing.assert_allclose(probable, weight / weight.sum(), rtol=1e-6)


def test_a_parameter_at_its_bound_stays_there():
    """Fails if what is held, or sits on a bound, moves with the scale, or counts in how probable one is."""
    design, seen, mean, sd = case(2, 40)
    held = np.array([False, False, True, False, False])
    estimate, covariance = np.full(N, 7.0), np.zeros((N, N))
    free = np.flatnonzero(~held)
    seen = seen - design[:, held] @ estimate[held]
    estimate[free], covariance[np.ix_(free, free)] = fitted(design[:, free], seen, mean[free], sd[free])
    found = by_scale(estimate, covariance, (mean, sd), np.ones(N, dtype=bool))
    alone = by_scale(
        estimate[free], covariance[np.ix_(free, free)], (mean[free], sd[free]), np.ones(len(free), dtype=bool)
    )
    assert (found[1][:, 2] == 7.0).all()
    assert not found[2][:, 2].any()
    np.testing.assert_allclose(found[1][:, free], alone[1])
    assert found[0] == pytest.approx(alone[0])


def test_what_strays_is_of_joints():
    """Fails if what places base and markers counts as a joint that strays from its maker's figures, or its geometry does not."""
    model = build(ur10(), ["geometry"])
    counts = dict(zip((one.name for one in model.parameters), strays(model), strict=True))
    assert counts["joint2.a"]
    assert not any(counts[one.name] for one in model.parameters if not one.joint)
    assert not all(counts.values())
