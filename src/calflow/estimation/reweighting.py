"""Settling: a fit whose weights agree with what it leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.estimation.fit import Fit, LeastSquares, Loss, fit, restated
from calflow.estimation.noise import LEAST_SCATTER, LackOfFit, Noise, averaged, lack_of_fit
from calflow.measurements.measurements import Measurements
from calflow.model import Model

START_ROWS = 2000  # rows on which several starts are compared; all rows are fitted from the best
NOISE_PASSES = 4  # fits in which an estimated noise settles


def fit_reweighted(
    model: Model, train: Measurements, level: Noise, starts: np.ndarray, loss: Loss, tolerance: float = 0.01
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit the means of repeats, and refit until the weights agree with what the fit leaves.

    A noise that is not known is estimated; to one that is known the model's own discrepancy is added where it shows.
    Returned are the fit, its noise, the lack of fit against the noise alone, and how many of the starts agree.
    """
    train, level = averaged(train, level)
    some = np.arange(len(train)) % max(1, len(train) // START_ROWS) == 0
    if len(starts) == 1:
        some[:] = True
    result, agree = fit(LeastSquares.of(model, train.only(some), level.only(some)), starts, loss)
    if not some.all():
        result, _ = fit(LeastSquares.of(model, train, level), result.estimate[None], loss)
    against_noise = lack = _lack(result, level, slice(0, 3), loss)
    for _ in range(NOISE_PASSES):
        fitted, before = level, level.total
        if level.known:
            level = replace(level, discrepancy=lack.discrepancy)
        else:
            level = replace(level, sigma=np.maximum(level.sigma * np.sqrt(lack.reduced_chi2), LEAST_SCATTER))
        if level.rotation is not None:
            turned = _lack(result, fitted, slice(3, 6), loss)
            level = replace(level, rotation_discrepancy=turned.discrepancy)
        if np.allclose(level.total, before, rtol=tolerance):
            result = restated(result, LeastSquares.of(model, train, level), loss)
            break
        result, _ = fit(LeastSquares.of(model, train, level), result.estimate[None], loss)
        lack = _lack(result, level, slice(0, 3), loss)
    return result, level, against_noise, agree


def _lack(result: Fit, level: Noise, axes: slice, loss: Loss) -> LackOfFit:
    """Lack of fit of the positions (axes 0 to 3) or the orientations (3 to 6); each bears its share of the parameters."""
    of_rotation = axes.start == 3
    error = result.residual[:, axes] * level.total[int(of_rotation)][:, None]
    sigma = level.rotation if of_rotation and level.rotation is not None else level.sigma
    determined = result.effective_parameters * 3 / result.residual.shape[1]
    return lack_of_fit(error, sigma, determined, robust=loss != "linear")
