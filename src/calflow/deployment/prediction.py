"""Prediction: where a calibrated robot's markers will be, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.estimation.calibrated import Identified
from calflow.measurements.measurements import Measurements


@dataclass(frozen=True)
class Prediction:
    """Predicted positions (n_rows, 3) [m] and their standard deviations per axis (n_rows, 3) [m]."""

    position: np.ndarray
    sd: np.ndarray


def predict_positions(known: Identified, data: Measurements) -> Prediction:
    """Return where the rows' markers will be.

    The standard deviations hold what is not known of the parameters and the model's own discrepancy, without the measuring
    device's noise; where that noise was estimated from the fit the two cannot be told apart, and both are in.
    """
    position = known.model.point(known.estimate, data.rows)
    jacobian = known.model.point_jacobian(known.estimate, data.rows)
    variance = np.einsum("nai,ij,naj->na", jacobian, known.covariance, jacobian)
    variance += (known.discrepancy if known.noise_known else known.sigma) ** 2
    return Prediction(position, np.sqrt(variance))


def beyond_limits(data: Measurements) -> list[str]:
    """Name the rows at which a joint is past its limits: what is predicted there is extrapolated."""
    q = data.joints @ data.robot.reading_matrix.T
    low, high = data.robot.limits.T
    past = (q < low - 1e-9) | (q > high + 1e-9)
    lines = data.table["line"].to_numpy()
    return [
        f"joint {i + 1} is past its limits in line {', '.join(map(str, lines[past[:, i]][:5]))}"
        f"{' and more' if past[:, i].sum() > 5 else ''}: the prediction there is extrapolated"
        for i in np.flatnonzero(past.any(axis=0))
    ]
