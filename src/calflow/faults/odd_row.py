"""Odd rows: outliers by the final model, once what explains the others is in it.

The tail of residuals: how far the largest of so many may be, by how heavy-tailed the others are.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import gammaln
from scipy.stats import chi, norm, t

from calflow.estimation.accuracy import distances, errors
from calflow.estimation.fit import Fit
from calflow.estimation.judgement import Studentised
from calflow.faults.base import Correction, Fault, fault
from calflow.faults.outlier import MOST, Outlier, together
from calflow.measurements.measurements import Measurements

FALSE = (
    1 / 500
)  # data sets that a gap's limit is made for; with several gaps tried, an outlier is named in fewer than one of 300
REMOVED, LEAST_REMOVED = 0.1, 3  # share and number of the rows that are held against the others at most
GAPS = 3  # gaps that are tried
DEGREES = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 22.0, 35.0, 60.0, 1e3)  # of Student's t, that are tried
DOUBT = 2.0  # fall of twice the log-likelihood up to which heavier tails are reckoned with
FEWEST = 60  # values, of which a tail can be told
TINY = 1e-12  # standard deviations: below it residuals are rounding
TOGETHER = 1.06  # by which three values of a heavy tail are longer together than the largest of them


def limit_of_length(values: np.ndarray) -> float:
    """Return the length that a row of independent residuals exceeds in fewer than one of 300 data sets; infinite where no row does.

    values (n_rows, size) are the studentised residuals of good and bad rows. The longest rows are held against the tail of all
    others, Student's t with as few degrees of freedom as these allow; as many rows at once as stand out by a gap, so that bad
    rows neither hide each other nor make the tail heavy.
    """
    n_rows, size = values.shape
    if values.size < FEWEST:
        return np.inf
    length = np.linalg.norm(values, axis=1)
    order = np.argsort(length)[::-1]
    most = max(LEAST_REMOVED, round(REMOVED * n_rows))
    ratio = length[order[:most]] / np.maximum(length[order[1 : most + 1]], TINY)
    for removed in sorted(1 + np.argsort(ratio)[::-1][:GAPS], reverse=True):
        limit = _limit(np.sort(np.abs(values[order[removed:]]).ravel()), size, n_rows)
        if length[order[removed - 1]] > limit:
            return limit
    return np.inf


def _limit(good: np.ndarray, size: int, rows: int) -> float:
    """Return the limit by the tail of the sorted sizes (n,) of values, size of which make each of so many rows."""
    fitted = [_fitted(good, degrees) for degrees in DEGREES]
    best = min(cost for cost, _ in fitted)
    degrees, scale = next(
        (degrees, scale) for degrees, (cost, scale) in zip(DEGREES, fitted, strict=True) if 2 * (cost - best) <= DOUBT
    )
    chance = FALSE / rows
    alone = t.isf(chance / (2 * size), degrees) if degrees < DEGREES[-1] else norm.isf(chance / (2 * size))
    return float(scale * max(chi.isf(chance, size), TOGETHER * alone))


def _fitted(good: np.ndarray, degrees: float) -> tuple[float, float]:
    """Return minus the log-likelihood and the scale of Student's t for sorted sizes (n,)."""

    def cost(log_scale: float) -> float:
        inside = len(good) * (constant - log_scale)
        return -float(inside - (degrees + 1) / 2 * np.log1p(squared / np.exp(2 * log_scale)).sum())

    squared = good**2 / degrees
    constant = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - np.log(degrees * np.pi) / 2
    middle = np.log(max(float(np.median(good)), TINY) / t.isf(0.25, degrees))
    found = minimize_scalar(cost, bounds=(middle - 1.0, middle + 1.0), method="bounded", options={"xatol": 1e-3})
    return float(found.fun), float(np.exp(found.x))


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
