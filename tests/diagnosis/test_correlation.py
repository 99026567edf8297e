"""Errors that rows share are taken out of what tests go by, exactly as their covariance says."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.regressors import Background

N, WAVES = 300, 7  # more rows than are whitened at once


@pytest.fixture(scope="module")
def left():
    """A background of two parts, and the covariance that it stands for."""
    rng = np.random.default_rng(3)
    waves = rng.standard_normal((N, WAVES)), 0.5 * rng.standard_normal((N, 3))
    weight = rng.uniform(0.5, 2.0, N)
    background = Background((("q1",), ("time",)), (), np.eye(N), waves, weight, (WAVES, 3.0), 18.0, 8)
    return background, np.eye(N) + sum(part @ part.T for part in waves)


def whitened(correlation, values):
    """The values as tests see them."""
    correlation.whiten(values)
    return values


def test_whitened_is_independent(left):
    """Fails if what is whitened keeps a correlation, or its scale changes."""
    background, covariance = left
    root = whitened(background.correlation(background.weight), np.eye(N))
    assert root @ covariance @ root.T == pytest.approx(np.eye(N), abs=0.05)


def test_rows_that_count_less_show_less_of_it(left):
    """Fails if weights that rows get later do not reach the background, or their common level does."""
    background, covariance = left
    factor = np.linspace(1.0, 3.0, N)
    root = whitened(background.correlation(5 * background.weight / factor), np.eye(N))
    scaled = np.median(1 / factor) ** -2 * (covariance - np.eye(N)) / np.outer(factor, factor) + np.eye(N)
    assert root @ scaled @ root.T == pytest.approx(np.eye(N), abs=0.05)


def test_what_a_part_makes_uncertain_is_as_sure_as_its_size(left):
    """Fails if an amplitude that only a badly known background makes uncertain counts as if all rows told its variance."""
    background, _ = left
    correlation = background.correlation(background.weight)
    inside, outside = 30 * background.parts[1][:, 0], np.linalg.svd(np.hstack(background.parts))[0][:, -1]
    both = whitened(correlation, np.column_stack([inside, outside]))
    sure = correlation.degrees_of_freedom(correlation.modes.T @ both, (both**2).sum(axis=0), 500.0)
    assert sure[0] < 6
    assert sure[1] == pytest.approx(500.0, rel=0.01)
