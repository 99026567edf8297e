"""The evidence of a cause against integrals by brute force, and what it makes of sizes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import norm

from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.screening import Screening
from calflow.estimation.variance_components import LOG_PRIOR, SIZES, explained, mixed, spent
from calflow.linear import Block


def density(x):
    """The prior density of one amplitude, over its usual size."""
    return np.exp(LOG_PRIOR) @ norm.pdf(x, scale=SIZES[:, None])


def test_the_closed_form_is_the_integral_over_an_amplitude():
    """Breaks if the sizes' weights do not add up, or likelihood and what the prior costs are not of the same size."""
    x = np.linspace(-60, 60, 400_001)
    for known, peak in ((0.5, 0.3), (30.0, 2.0), (4e3, -0.05), (100.0, 9.0)):
        integral = np.trapezoid(np.exp(-known * (x - peak) ** 2 / 2) * density(x), x)
        fallen, cost = explained(np.array([known * peak**2]), np.array([known]))
        assert mixed((fallen - cost) / 2) == pytest.approx(np.log(integral) + known * peak**2 / 2, abs=1e-3)


def test_it_is_the_integral_over_two_amplitudes_of_one_size():
    """Breaks if each of a cause's amplitudes has a size of its own: then two would be dearer than they are."""
    x = np.linspace(-25, 25, 4001)
    known, peak = np.array([60.0, 7.0]), np.array([0.7, -1.1])
    sized = [
        np.prod([np.trapezoid(np.exp(-k * (x - p) ** 2 / 2 + k * p**2 / 2) * norm.pdf(x, scale=size), x)
                 for k, p in zip(known, peak, strict=True)])
        for size in SIZES
    ]  # fmt: skip
    fallen, cost = explained(known * peak**2, known)
    assert mixed((fallen - cost) / 2) == pytest.approx(np.log(np.exp(LOG_PRIOR) @ sized), abs=1e-4)


def test_a_size_costs_what_the_prior_says_of_it():
    """Breaks if a gross mistake pays by its square, or what is usual is not told from what is huge."""
    values = np.array([0.01, 0.1, 1.0, 10.0])
    expected = -2 * np.log(density(values) * np.sqrt(2 * np.pi))
    cost = np.array([spent(np.array([value]), 1) for value in values]) + values**2
    assert cost == pytest.approx(expected)
    assert cost[3] < 15
    assert cost[1] < cost[2] < cost[3]


def test_neither_rows_nor_parameters_count_for_themselves():
    """Breaks if a cause of two parameters is charged by the number of rows: what the data do not narrow down costs nothing."""
    nothing = np.zeros(2)
    one = explained(np.array([400.0]), np.array([1e4]))
    two = explained(np.array([400.0, 0.0]), np.array([1e4, 1e-3]))
    assert mixed((two[0] - two[1]) / 2) == pytest.approx(mixed((one[0] - one[1]) / 2), abs=2e-3)
    assert mixed((explained(nothing, nothing)[0] - explained(nothing, nothing)[1]) / 2) == pytest.approx(0.0)


ROWS, OWN, DRAWS = 24, 14, 1500


def look_alikes(rng, hidden):
    """Two causes of one parameter that look alike beside many of the model's own, and data that hold one of them."""
    own, both = rng.standard_normal((ROWS, OWN)), rng.standard_normal((ROWS, 2))
    both[:, 1] += 2 * both[:, 0]
    size = rng.choice(SIZES, p=np.exp(LOG_PRIOR)) * rng.standard_normal()
    left = 0.3 * rng.standard_normal(ROWS) * np.exp(0.5 * rng.standard_normal()) - both[:, hidden] * size
    flat = np.full(OWN, 1e-8)
    factor = np.linalg.solve(own.T @ own + np.diag(flat), own.T @ left)
    blocks = [Block(name, both[:, [k]], 1.0) for k, name in enumerate("ab")]
    candidates = tuple(Candidate(block, np.array([k])) for k, block in enumerate(blocks))
    residual = (left - own @ factor) / 0.3
    jacobian, matrix = own / 0.3, TallMatrix.held(both / 0.3)
    return Screening.of(Regressors(residual, jacobian, flat, -flat * factor, 0.0, matrix, np.ones(2), candidates))


def test_few_rows_and_many_parameters_leave_it_open_as_often_as_they_should():
    """Breaks if residuals count that the model's own parameters have used up, as they do in n log chi²: names are too sure then."""
    rng, surest, right = np.random.default_rng(11), [], []
    for _ in range(DRAWS):
        hidden = int(rng.integers(2))
        first, *others = look_alikes(rng, hidden).scores
        if others:  # the data show both
            surest.append(1 / (1 + np.exp((first.cost - others[0].cost) / 2)))
            right.append(first.cause.name == "ab"[hidden])
    surest, right = np.array(surest), np.array(right)
    for least, most in pairwise((0.5, 0.7, 0.9, 0.99, 1.0)):
        here = (surest >= least) & (surest < most)
        error = np.sqrt((surest * (1 - surest))[here].sum())
        assert abs(right[here].sum() - surest[here].sum()) < 3 * error + 1
