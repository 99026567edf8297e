"""Ranks of the truth among draws: whether they are uniform, as they are where a posterior is right (Talts et al. 2018)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import binom, chi2

BINS = 20
POINTS = 40  # at which the empirical distribution is held against its band
SIMULATED = 4000  # sets of uniform ranks that the band is made from


def rank(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return how many of the draws (n_draws, n_quantities) are below the truth (n_quantities,)."""
    return np.asarray((draws < truth).sum(axis=0))


def chi2_p(ranks: np.ndarray, n_draws: int) -> np.ndarray:
    """Return the chance that uniform ranks (n_cases, n_quantities) spread as unevenly over the bins, shape (n_quantities,)."""
    share = (ranks + 0.5) / (n_draws + 1)
    expected = len(ranks) / BINS
    counts = np.array([np.bincount((BINS * own).astype(int), minlength=BINS) for own in share.T])
    return np.asarray(chi2.sf(((counts - expected) ** 2).sum(axis=1) / expected, BINS - 1))


@dataclass(frozen=True, eq=False)
class Band:
    """Where the empirical distribution of uniform ranks lies at all points at once, 95 times in 100.

    points (n_points,) are shares of the draws, low and high (n_points,) the least and the largest share of cases up to there.
    """

    points: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def of(n_cases: int, n_draws: int, rng: np.random.Generator, confidence: float = 0.95) -> Band:
        """Make the band by simulation (Säilynoja, Bürkner and Vehtari 2022, section 2.2)."""
        points = (np.linspace(0, n_draws + 1, POINTS + 1)[1:-1].astype(int)) / (n_draws + 1)
        drawn = rng.integers(n_draws + 1, size=(SIMULATED, n_cases))
        counts = _counted(drawn.T, n_draws, points)
        tail = 2 * np.minimum(binom.cdf(counts, n_cases, points), binom.sf(counts - 1, n_cases, points))
        gamma = float(np.quantile(tail.min(axis=1), 1 - confidence))
        low, high = (binom.ppf(q, n_cases, points) / n_cases for q in (gamma / 2, 1 - gamma / 2))
        return Band(points, low, high)

    def left_by(self, ranks: np.ndarray, n_draws: int) -> np.ndarray:
        """Return which quantities' ranks (n_cases, n_quantities) leave the band, shape (n_quantities,)."""
        share = _counted(ranks, n_draws, self.points) / len(ranks)
        return np.asarray(((share < self.low) | (share > self.high)).any(axis=1))


def _counted(ranks: np.ndarray, n_draws: int, points: np.ndarray) -> np.ndarray:
    """How many of the ranks (n_cases, n_sets) are up to each point, shape (n_sets, n_points)."""
    share = (np.sort(ranks, axis=0) + 1) / (n_draws + 1)
    return np.array([np.searchsorted(own, points + 1e-12, side="right") for own in share.T])


def shares_within(ranks: np.ndarray, n_draws: int, interval: float) -> np.ndarray:
    """Return the share of cases whose truth lies in the central interval of its draws, shape (n_quantities,).

    A rank that the interval's end cuts counts by its part inside.
    """
    low, high = (1 - interval) / 2, (1 + interval) / 2
    inside = np.minimum((ranks + 1) / (n_draws + 1), high) - np.maximum(ranks / (n_draws + 1), low)
    return np.asarray(np.clip(inside * (n_draws + 1), 0, 1).mean(axis=0))


def table_of(ranks: pd.DataFrame, n_draws: int, rng: np.random.Generator) -> pd.DataFrame:
    """Return a row a quantity: p of its ranks, whether they leave the band, and what its 50, 90 and 95 % intervals cover."""
    values = ranks.to_numpy()
    band = Band.of(len(values), n_draws, rng)
    covered = {f"in_{100 * level:.0f}": shares_within(values, n_draws, level) for level in (0.5, 0.9, 0.95)}
    told = {"quantity": ranks.columns, "p": chi2_p(values, n_draws), "leaves_band": band.left_by(values, n_draws)}
    return pd.DataFrame(told | covered)
