"""What the posterior promises is kept: truths lie in its intervals, and errors at further poses below what is said.

`benchmarks/promises.py` asks the same of hundreds of calibrations.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from scipy.stats import norm

from sampling.calibrations import DRAWS, SIGMA, SMALL, Case, Design, compared
from sampling.ranks import Band, chi2_p, rank


@pytest.fixture(scope="module")
def found(small_robots):
    """What the small robots' calibrations say."""
    return [compared(case, SMALL, known, drawn, deepcopy(rng)) for case, known, drawn, rng in small_robots]


def test_truths_lie_where_the_draws_are(found):
    """Fails if sampled intervals are 20 % too narrow, which would make the rms 1.2, or as much too wide."""
    z = norm.ppf((np.array([list(one.ranks.values()) for one in found]) + 0.5) / (DRAWS + 1))
    assert 0.89 < np.sqrt((z**2).mean()) < 1.13
    assert abs(z.mean()) < 0.16


def test_truths_lie_where_the_fits_covariance_says(found):
    """Fails if the fit's standard deviations are 20 % too small or too large."""
    z = np.concatenate([one.fitted for one in found])
    assert 0.83 < np.sqrt((z**2).mean()) < 1.17


def test_ranks_of_another_distribution_are_seen():
    """Fails if the check would pass draws that are 20 % too narrow: chi² and the band show it in 300 cases."""
    rng = np.random.default_rng(5)
    truth, right = rng.standard_normal((300, 1)), rng.standard_normal((300, 99, 1))
    ranks = [
        np.array([rank(one, own) for one, own in zip(draws, truth, strict=True)]) for draws in (right, 0.8 * right)
    ]
    band = Band.of(300, 99, rng)
    assert not band.left_by(ranks[0], 99).any()
    assert chi2_p(ranks[0], 99)[0] > 0.01
    assert band.left_by(ranks[1], 99).all()
    assert chi2_p(ranks[1], 99)[0] < 0.01


def test_the_band_holds_as_often_as_it_says():
    """Fails if the band is that of each point alone, which uniform ranks leave in a third of all cases."""
    rng = np.random.default_rng(6)
    ranks = rng.integers(100, size=(200, 400))
    left = Band.of(200, 99, rng).left_by(ranks, 99).mean()
    assert 0.02 < left < 0.09


def test_noise_is_that_of_the_data():
    """Fails if what is drawn is not what is claimed: residuals of the true parameters have the stated noise."""
    case = Case.drawn(Design(level=0.0), np.random.default_rng(7))
    left = case.data.position - case.model.position(case.truth, case.data.conditions)
    assert left.std() == pytest.approx(SIGMA, rel=0.15)
