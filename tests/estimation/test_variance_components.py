"""The sizes of random functions beside a linear model, against dense formulas and drawn truths."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.variance_components import PRIOR, SIZES, USUAL, VarianceComponents

ROWS, FITTED = 120, 5
PART = np.repeat([0, 1, 2], 8)


def drawn(rng, sizes, noise=1.0):
    """A design, functions of three parts, and what a fit of the design alone leaves of these functions at these sizes."""
    design, functions = rng.standard_normal((ROWS, FITTED)), rng.standard_normal((ROWS, len(PART)))
    amplitude = np.sqrt(np.array(sizes)[PART]) * rng.standard_normal(len(PART))
    return design, functions, functions @ amplitude + noise * rng.standard_normal(ROWS)


def components(design, functions, seen, floor):
    """The same as products beside the design."""
    left = np.eye(ROWS) - design @ np.linalg.pinv(design)
    return VarianceComponents(PART, 3, functions.T @ left @ functions, functions.T @ left @ seen,
                              float(seen @ left @ seen), ROWS - FITTED, floor)  # fmt: skip


def dense(design, functions, seen, variance, level):
    """Twice minus the logarithm of the restricted likelihood and of the prior at a level of the noise, but for a constant."""
    whole = np.eye(ROWS) + (functions * variance[PART]) @ functions.T
    weighed = np.linalg.solve(whole, design)
    normal = design.T @ weighed
    off = seen - design @ np.linalg.solve(normal, weighed.T @ seen)
    chi2 = off @ np.linalg.solve(whole, off)
    determinants = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(normal)[1]
    return (ROWS - FITTED) * np.log(level) + chi2 / level + determinants + variance.sum() / USUAL


@pytest.mark.parametrize("floor", [0.0, 1.0])
def test_the_cost_is_that_of_the_restricted_likelihood(floor):
    """Fails if the likelihood is not that of the whole covariance, or a noise that is known is let shrink below what it is."""
    case = drawn(np.random.default_rng(3), (0.2, 0.0, 0.0), noise=0.8)
    sizes, small, large = components(*case, floor), np.array([0.05, 0.0, 0.1]), np.array([0.3, 0.2, 0.0])
    expected = [dense(*case, variance, sizes.level(variance)) for variance in (small, large)]
    assert sizes.level(large) == pytest.approx(1.0) if floor else sizes.level(large) < 0.9
    assert sizes.cost(large) - sizes.cost(small) == pytest.approx(expected[1] - expected[0], rel=1e-9)


def test_the_most_likely_sizes_are_those_of_the_least_cost():
    """Fails if the search for the sizes ends elsewhere than where the likelihood says."""
    sizes = components(*drawn(np.random.default_rng(4), (0.3, 0.1, 0.0)), 0.0)
    best = sizes.most_likely(np.array([0.1, 0.1, 0.0]))
    for k in (0, 1):
        for factor in (0.8, 1.25):
            other = np.where(np.arange(3) == k, factor * best, best)
            assert sizes.cost(other) > sizes.cost(best) - 1e-3


def test_expected_sizes_are_those_of_the_draws():
    """Fails if a part that is there is believed to be nothing, or one that is not to be something."""
    rng, found = np.random.default_rng(5), []
    for _ in range(60):
        sizes = components(*drawn(rng, (0.1, 0.0, 0.0)), 1.0)
        found.append(sizes.expected(sizes.accepted()))
    there, *none = np.mean(found, axis=0)
    assert there == pytest.approx(0.1, rel=0.25)
    assert max(none) < 0.01


@pytest.mark.parametrize("floor", [0.0, 1.0])
def test_an_expected_size_is_the_mean_of_its_posterior(floor):
    """Fails if a size that few functions tell is taken for the likeliest one, or for there without a doubt."""
    case = drawn(np.random.default_rng(6), (0.1, 0.1, 0.0))
    others = np.array([0.0, 0.1, 0.0])
    sizes = components(*case, floor)
    tried = [others + np.array([variance, 0.0, 0.0]) for variance in np.append(0.0, USUAL * SIZES**2)]
    costs = np.array([dense(*case, one, sizes.level(one)) - one.sum() / USUAL for one in tried])
    weight = np.exp((costs[0] - costs) / 2) * np.append(1.0, PRIOR * 2 / 2)  # one of the two others is found
    expected = weight @ [one[0] for one in tried] / weight.sum()
    assert sizes.expected(others + np.array([0.2, 0.0, 0.0]))[0] == pytest.approx(expected, rel=1e-9)


def test_parts_that_are_found_make_others_likelier():
    """Fails if a part of which the data say nothing is as unlikely beside two that they show as beside none."""
    design, functions, seen = drawn(np.random.default_rng(7), (0.1, 0.1, 0.0))
    sizes = components(design, functions * (PART < 2), seen, 1.0)
    for found, share in (([0.0, 0.0, 0.0], 1 / 4), ([0.1, 0.0, 0.0], 1 / 2), ([0.1, 0.1, 0.0], 3 / 4)):
        assert sizes.probabilities(np.array(found))[2].sum() == pytest.approx(share)
