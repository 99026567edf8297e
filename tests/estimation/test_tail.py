"""The tail of residuals: good rows pass, whatever their tail, and ten standard deviations do not where noise is normal."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.faults.outlier import limit_of_length


def longest_and_limit(draw, rows, times):
    """The longest of so many rows, and the limit, for several data sets."""
    found = [
        (np.linalg.norm(values, axis=1).max(), limit_of_length(values))
        for values in (draw((rows, 3)) for _ in range(times))
    ]
    return np.array(found).T


@pytest.mark.parametrize("degrees", [3, 5, 1e6])
def test_heavy_tails_raise_no_alarm(degrees):
    """Fails if the limit is that of normal noise where the others say otherwise, or is passed again and again."""
    rng = np.random.default_rng(1)
    longest, limit = longest_and_limit(lambda shape: rng.standard_t(degrees, shape), 120, 30)
    assert (longest > limit).sum() <= 1


@pytest.mark.parametrize(("size", "rows", "bad"), [(12.0, 120, 2), (10.0, 120, 1), (12.0, 90, 2), (12.0, 200, 12)])
def test_ten_standard_deviations_are_found_in_normal_noise(size, rows, bad):
    """Fails if outliers hide each other, make the tail heavy, or doubt about the tail puts the limit out of reach."""
    rng, missed = np.random.default_rng(2), 0
    for _ in range(20):
        values = rng.standard_normal((rows, 3))
        way = rng.standard_normal((bad, 3))
        values[:bad] += size * way / np.linalg.norm(way, axis=1, keepdims=True)
        missed += bool((np.linalg.norm(values[:bad], axis=1) < limit_of_length(values)).any())
    assert missed <= 2


def test_a_handful_of_values_tells_no_tail():
    """Fails if a tail is told by a few values, or by residuals that are rounding alone."""
    rng = np.random.default_rng(3)
    assert limit_of_length(10.0 ** rng.uniform(-1, 1, (10, 3))) == np.inf
    assert limit_of_length(np.zeros((40, 3))) == np.inf
