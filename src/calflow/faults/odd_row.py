"""Odd rows: outliers by the final model, once what explains the others is in it."""

from __future__ import annotations

import numpy as np

from calflow.estimation.accuracy import distances, errors
from calflow.estimation.fit import Fit
from calflow.estimation.judgement import Studentised
from calflow.estimation.tail import limit_of_length
from calflow.faults.base import Correction, Fault, fault
from calflow.faults.outlier import MOST, Outlier, together
from calflow.measurements.measurements import Measurements


def odd_rows(result: Fit, data: Measurements, found: Studentised) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Return which rows (n_rows,) are outliers by the final model, and the fault that says so, by its lines.

    The limit is by the residuals' own tail. Rows that are off together (a payload, a marker, poses in a row the same way) are no
    outliers. They are told, not left out: the fit has given them little weight, and accuracy counts them.
    """
    used = data.train | data.held_out
    odd = np.zeros(len(data), dtype=bool)
    length = np.sqrt(found.squared)
    for size in np.unique(found.units[used]):
        alike = used & (found.units == size)
        values = found.values[alike]
        odd[alike] = length[alike] > limit_of_length(values[~np.isnan(values)].reshape(-1, int(size)))
    error = errors(result.model, result.estimate, data)
    odd &= ~together(data, np.nan_to_num(error), odd)
    if not 0 < odd.sum() <= MOST * used.sum():
        return np.zeros(len(data), dtype=bool), ()
    far, times = 1e3 * distances(error[odd]), found.whitened[odd]
    statement = (
        f"the measured values in LINES do not fit the final model: off by {_span(far, '.3g')} mm, {_span(times, '.2g')} times the "
        "expected; they hardly count in the fit, and count in the accuracy: measure again"
    )
    corrections = [Correction(int(row) + 1) for row in np.flatnonzero(odd)]
    return odd, (fault(Outlier(), data, 0, corrections, "told", statement),)


def _span(values: np.ndarray, digits: str) -> str:
    """Say from where to where values (n,) go."""
    low, high = (format(float(end), digits) for end in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"
