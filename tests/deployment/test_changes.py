"""Changes over time: what is promised of false alarms holds with correlated estimates, whatever else moves."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom

from calflow.deployment.history import changes, mean_of_runs
from calflow.estimation.difference import LikelihoodEstimate

N, RUNS, ALARM, CASES = 6, 5, 0.1, 30  # benchmarks/history.py has more of them
PRIOR = np.array([1e-3, 5e-4, 1e-3, 2e-3, 1e-3, 1e-3])


def calibrated(rng, truth, loose=1.0):
    """A calibration by linear least squares of 40 readings with a prior; the third and fourth parameters are near each other.

    loose scales what tells these two apart: 0 leaves their difference undetermined.
    """
    design = rng.standard_normal((40, N)) / PRIOR
    design[:, 3] = (design[:, 2] * PRIOR[2] + 0.3 * loose * rng.standard_normal(40)) / PRIOR[3]
    sigma = 0.5
    read = design @ truth + sigma * rng.standard_normal(40)
    information = design.T @ design / sigma**2
    covariance = np.linalg.inv(information + np.diag(PRIOR**-2.0))
    return LikelihoodEstimate.of(covariance @ (design.T @ read) / sigma**2, covariance, np.zeros(N), PRIOR)


def histories(seed, truths, **how):
    """Independent histories with their generators; truths has a row a run."""
    for case in range(CASES):
        rng = np.random.default_rng([seed, case])
        robot = PRIOR * rng.standard_normal(N)
        yield [calibrated(rng, robot + truth, **how) for truth in truths], rng


def test_the_prior_is_taken_out():
    """Fails if what the measurements say is still drawn to the prior, or their covariance is not that of least squares."""
    rng = np.random.default_rng(1)
    design, truth = rng.standard_normal((30, N)) / PRIOR, PRIOR * rng.standard_normal(N)
    information = design.T @ design
    covariance = np.linalg.inv(information + np.diag(PRIOR**-2.0))
    mean = 0.1 * PRIOR
    alone = LikelihoodEstimate.of(covariance @ (design.T @ (design @ truth) + mean / PRIOR**2), covariance, mean, PRIOR)
    np.testing.assert_allclose(alone.value, truth, rtol=1e-4)
    np.testing.assert_allclose(alone.covariance, np.linalg.inv(information), rtol=1e-4, atol=1e-12)


def test_an_inexact_covariance_tells_nothing_of_what_was_not_measured():
    """Fails if a covariance that smooth errors made a little wider than the prior leaves an estimate that is sure of nonsense."""
    estimate, covariance = 0.02 * PRIOR, 1.001 * np.diag(PRIOR**2)
    alone = LikelihoodEstimate.of(estimate, covariance, np.zeros(N), PRIOR)
    assert (np.abs(alone.value) < alone.sd).all()
    assert not alone.told.any()


def test_nothing_that_stayed_is_said_to_have_moved():
    """Fails if more histories than promised have a false alarm, counted over all parameters and runs, also where others moved."""
    still = np.zeros((RUNS, N))
    moved = still.copy()
    moved[2:, 2] = 8e-4  # beside the fourth, with which it is correlated by 0.95
    alarms = [bool(changes(runs, ALARM, rng)) for runs, rng in histories(1, still)]
    others = [any(one.parameter != 2 for one in changes(runs, ALARM, rng)) for runs, rng in histories(2, moved)]
    most = binom.ppf(0.999, CASES, ALARM)
    assert sum(alarms) <= most
    assert sum(others) <= most


def test_two_steps_are_found_where_they_are():
    """Fails if a step that is large against what is known is missed, put at another run, or has another size."""
    truths = np.zeros((RUNS, N))
    truths[1:, 0], truths[3:, 0] = 1e-3, -1e-3
    for runs, rng in list(histories(3, truths))[:10]:
        found = [one for one in changes(runs, 0.01, rng) if one.parameter == 0]
        assert [one.after for one in found] == [0, 2]
        assert all(one.p < 0.001 for one in found)
        begins = [0, *(one.after + 1 for one in found), RUNS]
        first, second, third = (mean_of_runs(runs[begin:end], 0) for begin, end in pairwise(begins))
        assert second[0] - first[0] == pytest.approx(1e-3, abs=5 * np.hypot(first[1], second[1]))
        assert third[0] - second[0] == pytest.approx(-2e-3, abs=5 * np.hypot(third[1], second[1]))


def test_a_slow_drift_is_found_though_no_two_neighbours_differ():
    """Fails if only steps between neighbouring runs are looked at."""
    truths = np.outer(np.arange(RUNS), [0, 0, 0, 0, 0, 2.2e-4])
    found = [[one for one in changes(runs, 0.01, rng) if one.parameter == 5] for runs, rng in histories(4, truths)]
    assert np.mean([bool(own) for own in found]) > 0.8
    assert np.mean([any(one.last - one.first > 1 for one in own) for own in found]) > 0.5


def test_a_move_along_what_is_not_determined_names_nobody():
    """Fails if one of two parameters of which only the sum is measured is said to have moved."""
    truths = np.zeros((RUNS, N))
    truths[2:, 2] = 3e-3
    for runs, rng in list(histories(5, truths, loose=0.0))[:20]:
        assert not {one.parameter for one in changes(runs, ALARM, rng)} & {2, 3}
        assert not runs[0].told[[2, 3]].any()
        assert runs[0].told[[0, 1, 4, 5]].all()
