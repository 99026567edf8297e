"""A lack of fit is claimed as rarely as promised, whatever tells the noise and whatever its tails."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from calflow.estimation.lack_of_fit import Evidence, lack_of_fit

POSES, CASES = 100, 400


def one(repeated: int, times: int, degrees: int, rng: np.random.Generator, misfit: float = 0.0):
    """The lack of fit of clean errors of POSES points, the first of which are repeated; misfit is added, in sigma."""
    count = np.where(np.arange(POSES) < repeated, times, 1)
    noise = (
        rng.standard_t(degrees, (POSES, times, 3)) / np.sqrt(degrees / (degrees - 2))
        if degrees
        else rng.standard_normal((POSES, times, 3))
    )
    noise[count == 1] = noise[count == 1, :1]
    mean = noise.mean(axis=1)
    squared, freedom = ((noise - mean[:, None]) ** 2).sum(axis=(1, 2)), 3.0 * (count - 1)
    sigma = float(np.sqrt(squared.sum() / freedom.sum())) if repeated else 1.0
    error = (mean + misfit * rng.standard_normal((POSES, 3))).ravel()
    poses = np.arange(POSES)
    told = Evidence(squared / sigma**2, freedom, poses, count, 0 * poses)
    return lack_of_fit(error, sigma / np.sqrt(np.repeat(count, 3)), 0, poses.repeat(3), told)


@pytest.mark.parametrize("degrees", [0, 5])
@pytest.mark.parametrize(("repeated", "times"), [(0, 1), (10, 4), (POSES, 3)])
def test_clean_cases_seldom_look_wrong(repeated, times, degrees):
    """Fails if few repeats, or heavy tails, make clean data look as if the model lacked something."""
    rng = np.random.default_rng(31)
    p = np.array([one(repeated, times, degrees, rng).p for _ in range(CASES)])
    for level in (0.01, 0.1):
        low, high = binom.interval(0.998, CASES, level)
        assert 0.5 * low <= (p < level).sum() <= 1.5 * high


def test_a_misfit_as_large_as_the_noise_is_found():
    """Fails if the care for heavy tails hides a model that lacks something, or its size."""
    rng = np.random.default_rng(32)
    for repeated, times in ((0, 1), (10, 4), (POSES, 3)):
        lack = one(repeated, times, 0, rng, misfit=1.0)
        assert lack.p < 1e-4
        assert lack.discrepancy == pytest.approx(1.0, rel=0.35)


def test_rows_that_share_their_pose_are_one_piece_of_evidence():
    """Fails if three markers, which share the error of repeating a pose, count as three."""
    rng = np.random.default_rng(33)
    poses = np.arange(POSES)
    told = Evidence(np.zeros(3 * POSES), np.zeros(3 * POSES), poses.repeat(3), np.ones(3 * POSES), 0 * poses.repeat(3))
    p = []
    for _ in range(CASES):
        error = np.repeat(rng.standard_normal((POSES, 1, 3)), 3, axis=1).ravel()
        p.append(lack_of_fit(error, np.ones(9 * POSES), 0, np.arange(3 * POSES).repeat(3), told).p)
    assert (np.array(p) < 0.01).mean() < 0.02
