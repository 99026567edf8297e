"""Outliers: one bad row decides neither how much the model lacks nor which cause is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.fitted import HUBER
from diagnosis.found import cause, hidden, start

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


def with_gross_row(size):
    """Poses of a robot whose model lacks several millimetres, one of them off by size [m]."""
    data = hidden([(ECCENTRIC, (5e-3, -3e-3))])
    table = data.table.copy()
    table.loc[0, "x"] += size
    return replace(data, table=table)


@pytest.fixture(scope="module")
def fits():
    """Fits without the cause, of good rows and beside a gross one."""
    return [start(with_gross_row(size)).with_causes([]) for size in (0.0, 0.1)]


def test_its_weight_is_hubers_beside_a_large_discrepancy(fits):
    """Fails if only the device's noise is enlarged: where the model's own error is larger, the row keeps its weight."""
    gross = fits[1]
    whitened = gross.fit.residual.reshape(-1, 3)
    size = np.linalg.norm(whitened, axis=1)
    factor = gross.outlier_factor
    assert factor[0] > 3
    assert np.all(factor[1:] == 1)
    assert size[0] == pytest.approx(HUBER, rel=0.2)


def test_the_peaks_of_what_the_model_lacks_are_none(fits):
    """Fails if rows where a smooth error is large are down-weighted: they are the promise's, too."""
    assert np.all(fits[0].outlier_factor == 1)


def test_it_does_not_decide_how_much_the_model_lacks(fits):
    """Fails if one bad row enlarges the discrepancy of all others."""
    clean, gross = (np.median(fitted.noise.total) for fitted in fits)
    assert gross == pytest.approx(clean, rel=0.15)
