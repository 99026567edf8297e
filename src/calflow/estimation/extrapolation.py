"""Extrapolation: joints whose held-out readings lie beyond what was fitted."""

from __future__ import annotations

import numpy as np

from calflow.estimation.fit_summary import Extrapolation
from calflow.measurements.measurements import Measurements

BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted ones


def extrapolation(data: Measurements) -> tuple[Extrapolation, ...]:
    """Return the joints whose held-out readings lie beyond what was fitted: their accuracy is a guess, good or bad."""
    train, heldout = data.joints[data.train], data.joints[data.held_out]
    if not len(heldout):
        return ()
    low, high = train.min(axis=0), train.max(axis=0)
    margin = BEYOND * np.maximum(high - low, np.ptp(data.joints[data.train | data.held_out], axis=0))
    beyond = (heldout < low - margin) | (heldout > high + margin)
    return tuple(
        Extrapolation(joint=int(i) + 1, rows=int(beyond[:, i].sum())) for i in np.flatnonzero(beyond.any(axis=0))
    )


def beyond(readings: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return which joint readings (n_rows, n_joints) lie outside those measured (n_measured, n_joints) by a tenth of the range."""
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low)
    return np.asarray((readings < low - margin) | (readings > high + margin))
