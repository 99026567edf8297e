"""Segments: the most likely sequence of states of rows, with a penalty for changes of state."""

from __future__ import annotations

import numpy as np

ABSENT = 10.0  # cost of a row without an error in a state


def state_cost(error: np.ndarray, scale: float) -> np.ndarray:
    """Return the cost of errors (…) [m]: that of a Cauchy distribution of three times a scale [m]."""
    return np.where(np.isfinite(error), np.log1p((error / (3 * max(scale, 1e-9))) ** 2), ABSENT)


def states(costs: np.ndarray, change: float) -> np.ndarray:
    """Return the states (n_rows,) of least total cost, from costs (n_states, n_rows) and that of a change (Viterbi 1967)."""
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
