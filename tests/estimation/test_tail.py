"""The tail of residuals: good rows pass, whatever their tail, and ten standard deviations do not where noise is normal."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.tail import limit_of_length


def lengths_and_limits(draw, rows, times):
    """The longest of so many rows, and the limit, for several data sets."""
    found = [(np.linalg.norm(values, axis=1).max(), limit_of_length(values.ravel(), 3, rows))
             for values in (draw((rows, 3)) for _ in range(times))]  # fmt: skip
    return np.array(found).T


@pytest.mark.parametrize("degrees", [3, 5])
def test_heavy_tails_raise_no_alarm(degrees):
    """Fails if the limit is that of normal noise where the bulk says otherwise."""
    rng = np.random.default_rng(1)
    longest, limit = lengths_and_limits(lambda shape: rng.standard_t(degrees, shape), 120, 20)
    assert (longest > limit).sum() <= 1


def test_ten_standard_deviations_are_found_in_normal_noise():
    """Fails if the outliers themselves, or doubt about the tail, put the limit out of reach."""
    rng = np.random.default_rng(2)

    def draw(shape):
        values = rng.standard_normal(shape)
        values[:2] = [[10.0, 0, 0], [0, -8.0, 8.0]]
        return values

    _, limit = lengths_and_limits(draw, 120, 20)
    assert (limit < 10.0).mean() >= 0.85
    assert limit.min() > 5.0
    assert limit_of_length(rng.standard_normal(30), 3, 10) == np.inf
