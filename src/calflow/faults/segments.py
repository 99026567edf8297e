"""Segments: the sequence of states that explains the rows best, where a change of state is dear."""

from __future__ import annotations

import numpy as np

ABSENT = 10.0  # what a row costs that a state says nothing about


def state_cost(error: np.ndarray, scale: float) -> np.ndarray:
    """Return what errors (…) [m] cost against a scale [m]: hardly anything where usual, and growing slowly."""
    return np.where(np.isfinite(error), np.log1p((error / (3 * max(scale, 1e-9))) ** 2), ABSENT)


def states(costs: np.ndarray, change: float) -> np.ndarray:
    """Return the cheapest sequence of states (n_rows,) for costs (n_states, n_rows) and of a change (Viterbi 1967)."""
    n_states, n_rows = costs.shape
    total, came = costs[:, 0].copy(), np.empty((n_rows, n_states), dtype=int)
    for k in range(1, n_rows):
        best = int(total.argmin())
        stay = total <= total[best] + change
        came[k] = np.where(stay, np.arange(n_states), best)
        total = np.where(stay, total, total[best] + change) + costs[:, k]
    path = np.empty(n_rows, dtype=int)
    path[-1] = total.argmin()
    for k in range(n_rows - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path
