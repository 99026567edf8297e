"""Pooled repeats withstand gross errors, and take heavy tails for what they are."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.noise import scatter


def drawn(rng, poses, times, degrees=0):
    """Scatter of unit variance, and which pose each row is of."""
    shape = (poses * times, 3)
    noise = rng.standard_t(degrees, shape) / np.sqrt(degrees / (degrees - 2)) if degrees else rng.standard_normal(shape)
    return noise, np.repeat(np.arange(poses), times)


def classical(error, group):
    """Sum of squares about the means over its degrees of freedom."""
    means = np.stack([np.bincount(group, weights=axis) / np.bincount(group) for axis in error.T], axis=1)
    return np.sqrt(((error - means[group]) ** 2).sum() / (3 * (len(error) - len(means))))


@pytest.mark.parametrize(("poses", "times", "degrees"), [(60, 3, 0), (10, 4, 0), (60, 2, 5), (60, 3, 3)])
def test_without_gross_errors_it_is_the_classical_estimate(poses, times, degrees):
    """Fails if normal noise loses precision, or heavy tails are cut off."""
    rng = np.random.default_rng(41)
    for _ in range(10):
        error, group = drawn(rng, poses, times, degrees)
        found = scatter(error, group)
        assert not found.gross.any()
        assert found.sigma == pytest.approx(classical(error, group), rel=1e-12)
        assert found.freedom.sum() == pytest.approx(3 * poses * (times - 1), rel=1e-12)


@pytest.mark.parametrize(("poses", "times"), [(100, 3), (60, 2), (20, 4)])
def test_gross_errors_do_not_widen_the_noise(poses, times):
    """Fails if one row in twenty that is 25 sigma off makes the noise two or three times too large."""
    rng = np.random.default_rng(42)
    error, group = drawn(rng, poses, times)
    wrong = np.arange(7, len(error), 20)
    error[wrong] += 25 * np.array([0.6, 0.0, 0.8])
    assert classical(error, group) > 2
    found = scatter(error, group)
    assert found.sigma == pytest.approx(1.0, abs=4 / np.sqrt(2 * found.freedom.sum()))
    assert set(wrong) <= set(np.flatnonzero(found.gross))
    assert found.gross.sum() <= len(wrong) * (2 if times == 2 else 1)


@pytest.mark.parametrize("times", [3.0, 5.0])
def test_a_day_of_larger_noise_has_no_gross_errors_for_that(times):
    """Fails if the repeats of a noisy day count as gross errors by the others', or errors of that day as its noise."""
    rng = np.random.default_rng(44)
    error, group = drawn(rng, 40, 3)
    day = np.where(group < 10, "windy", "calm")
    error[day == "windy"] *= times
    error[7] += 60 * times * np.array([0.6, 0.0, 0.8])
    found = scatter(error, group, day)
    assert np.flatnonzero(found.gross).tolist() == [7]
    assert found.only(day == "windy").sigma == pytest.approx(times, rel=0.3)


def test_rows_that_were_not_repeated_say_nothing():
    """Fails if single rows count as scatter, or give a number that looks like a noise."""
    error, group = np.ones((4, 3)), np.arange(4)
    assert np.isnan(scatter(error, group).sigma)
    assert scatter(error, group).freedom.sum() == 0


def test_an_axis_of_another_unit_is_scatter_of_all_rows():
    """Fails if every repeat looks gross, as of an axis in metres read as millimetres, and nothing is left to measure them by."""
    error, group = drawn(np.random.default_rng(43), 40, 2)
    error[:, 0] *= 1e6
    found = scatter(error, group)
    assert not found.gross.any()
    assert found.sigma == pytest.approx(classical(error, group), rel=1e-12)
