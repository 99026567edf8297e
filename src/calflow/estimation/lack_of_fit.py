"""Lack of fit: whether a model leaves more than its noise, and how much more."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, f

from calflow.estimation.noise import NORMAL_MEDIAN, Noise
from calflow.measurements.measurements import Measurements

SIGNIFICANT = 0.01  # p-value below which a lack of fit is believed
GROSS = 4.0  # robust standard deviations from which a robust fit takes an error for an outlier


@dataclass(frozen=True)
class LackOfFit:
    """Errors of one kind against their noise: chi² per degree of freedom, its p-value, and the discrepancy."""

    reduced_chi2: float
    p: float
    discrepancy: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of the noise of a fit's rows, apart from the fit, each an array (n_rows,).

    pose numbers what may share errors, count says how many measurements a row is the mean of; squared is what these
    scatter about it, in units of their noise, freedom its degrees of freedom, zero where the noise is stated. doubted are
    rows with a gross error among their repeats. series numbers what has a noise of its own.
    """

    pose: np.ndarray
    count: np.ndarray
    squared: np.ndarray
    freedom: np.ndarray
    doubted: np.ndarray
    series: np.ndarray

    @staticmethod
    def of(data: Measurements, noise: Noise) -> Evidence:
        """Return that of the means of repeats (see `repeats.averaged`) and their noise."""
        pose = np.unique(data.table["pose"], return_inverse=True)[1]
        nothing = np.zeros(len(data))
        repeats = np.any([noise.of_series(k) & (s == "repeats") for k, s in enumerate(noise.sources)], axis=0)
        if noise.scatter is None or not repeats.any():
            return Evidence(pose, data.repeats, nothing, nothing, nothing > 0, data.series_number)
        single = noise.sigma * np.sqrt(data.repeats)
        return Evidence(pose, data.repeats, np.where(repeats, noise.scatter.squared / single**2, 0.0),
                        np.where(repeats, noise.scatter.freedom, 0.0), noise.scatter.gross, data.series_number)  # fmt: skip

    def only_where(self, rows: np.ndarray) -> Evidence:
        """Return the same where repeats tell the noise of some rows (a mask) alone, as if that of the others were stated."""
        return replace(
            self, squared=np.where(rows, self.squared, 0.0), freedom=np.where(rows, self.freedom, 0.0), doubted=self.doubted & rows
        )  # fmt: skip

    @staticmethod
    def stated(n: int) -> Evidence:
        """Return that of n rows whose noise is stated, each a pose of its own."""
        return Evidence(np.arange(n), np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool), np.zeros(n, int))


def lack_of_fit(
    error: np.ndarray,
    sigma: np.ndarray,
    determined: float,
    rows: np.ndarray | None = None,
    evidence: Evidence | None = None,
    trimmed: bool = False,
) -> LackOfFit:
    """Compare errors (n,) with their noise (n,); determined is the number of parameters they fixed.

    The discrepancy is what has to be added to the noise for chi² to equal its degrees of freedom; zero where the noise
    explains the errors (p above 1 %). rows (n,) numbers the errors' rows in the evidence of their noise, all of them stated
    and apart where there is none. After a robust fit errors are trimmed: rows far off do not make a discrepancy.
    """
    rows = np.arange(error.size) if rows is None else rows
    told = Evidence.stated(int(rows.max()) + 1) if evidence is None else evidence
    reduced, p = _tested((error / sigma) ** 2, determined / error.size, rows, told)
    if trimmed:
        size = np.abs(error) / sigma
        scale = max(1.0, float(np.median(size)) / NORMAL_MEDIAN)
        kept = ~np.isin(rows, rows[size >= GROSS * scale])
        error, sigma = error[kept], sigma[kept]
        reduced = float(((error / sigma) ** 2).sum()) / max(1.0, error.size - determined)
    degrees_of_freedom = max(1.0, error.size - determined)

    def excess(discrepancy: float) -> float:
        return float(((error / np.hypot(sigma, discrepancy)) ** 2).sum()) - degrees_of_freedom

    if p > SIGNIFICANT or excess(0.0) <= 0:
        return LackOfFit(reduced, p, 0.0)
    return LackOfFit(reduced, p, brentq(excess, 0.0, 10 * float(np.abs(error).max())))


def _tested(squared: np.ndarray, share: float, rows: np.ndarray, told: Evidence) -> tuple[float, float]:
    """Return chi² per degree of freedom of squared errors (n,) in units of their noise, and the chance of as much.

    An F test against the scatter of repeats, a chi² test against stated noise, both between where some series have
    repeats; share is that of the degrees of freedom which the fit took. Its degrees of freedom are reduced by the
    kurtosis of the noise (Box and Andersen 1955), which is estimated from the spread over poses of squared errors and
    squared scatter alike. So heavy tails, and errors that the rows of a pose share, do not count as evidence.
    """
    believed = ~told.doubted[rows]
    if not believed.any():
        believed[:] = True
    squared, rows = squared[believed], rows[believed]
    here = np.unique(rows)
    n_series = int(told.series.max()) + 1
    units = np.bincount(told.series[rows], minlength=n_series)
    freedom = np.bincount(told.series[here], weights=told.freedom[here], minlength=n_series)
    scatter = np.bincount(told.series[here], weights=told.squared[here], minlength=n_series)
    level = np.where(freedom > 0, scatter / np.maximum(freedom, 1e-9), 1.0)
    level = np.where(level > 0, level, 1.0)
    weight = np.where(freedom > 0, units / units.sum() / np.maximum(freedom, 1e-9), 0.0)[told.series]
    squared = squared / level[told.series[rows]]

    pose = np.unique(told.pose[here], return_inverse=True)[1]
    of_unit = pose[np.searchsorted(here, rows)]
    found, n = np.bincount(of_unit, weights=squared), np.bincount(of_unit)
    repeats = np.bincount(pose, weights=told.count[here]) / np.bincount(pose)
    between, within = n * (1 - share), np.bincount(pose, weights=told.freedom[here])
    shown = np.bincount(pose, weights=told.squared[here] / level[told.series[here]])
    against = np.bincount(pose, weights=(weight * told.freedom)[here])

    d1 = max(1.0, float(between.sum()))
    reduced = float(found.sum()) / d1
    scaled = found / max(reduced, 1e-300)
    tails = float(((scaled - between) ** 2 - 2 * between + (shown - within) ** 2 - 2 * within).sum())
    kurtosis = max(0.0, tails / float(((between**2 + within**2) / (n * repeats)).sum()))
    of_scatter = float(2 * (weight**2 * told.freedom)[here].sum())
    plain = 2 / d1 + of_scatter
    reduction = plain / (plain + kurtosis * float((n / repeats * (between / (n * d1) - against / n) ** 2).sum()))
    if not of_scatter:
        return reduced, float(chi2.sf(reduced * d1 * reduction, d1 * reduction))
    return reduced, float(f.sf(reduced, d1 * reduction, 2 / of_scatter * reduction))
