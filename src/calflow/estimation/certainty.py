"""Certainty: how sure a calibrated model's own positions are, apart from the device that measures them."""

from __future__ import annotations

import numpy as np

from calflow.estimation.calibrated import Identified


def position_variance(known: Identified, rows: np.ndarray) -> np.ndarray:
    """Return the variance of each row's predicted position per axis, shape (n_rows, 3) [m²].

    It holds what is not known of the parameters and the model's own discrepancy, which no further measurement of the same
    poses takes away. Where the noise was estimated from the fit the two cannot be told apart, and both are in.
    """
    jacobian = known.model.point_jacobian(known.estimate, rows)
    of_parameters = np.einsum("nai,ij,naj->na", jacobian, known.covariance, jacobian, optimize=True)
    return np.asarray(of_parameters + unexplained(known) ** 2)


def unexplained(known: Identified) -> float:
    """Return the standard deviation per axis [m] of what the model errs by beside its parameters' errors."""
    return known.discrepancy if known.noise_known else known.device[0].at_rows
