"""Reweighting: a fit whose weights agree with what it leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.estimation.fit import Fit, fit, restated
from calflow.estimation.lack_of_fit import Evidence, LackOfFit, lack_of_fit
from calflow.estimation.least_squares import LeastSquares, Loss
from calflow.estimation.noise import LEAST_SCATTER, Noise
from calflow.estimation.nuisance import observing
from calflow.estimation.repeats import averaged
from calflow.measurements.measurements import Measurements
from calflow.model import Model

START_ROWS = 2000  # rows on which several starts are compared; all rows are fitted from the best
NOISE_PASSES = 4  # fits in which an estimated noise settles


def fit_reweighted(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss, tolerance: float = 0.01
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit the means of repeats, and refit until the weights agree with what the fit leaves.

    A noise that is not known is estimated, series by series; to one that is known the model's own discrepancy is added where
    it shows. Returned are the fit, its noise, the lack of fit against the noise alone, and how many of the starts agree.
    """
    model = observing(model, train)
    train, noise = averaged(train, noise)
    some = np.arange(len(train)) % max(1, len(train) // START_ROWS) == 0
    if len(starts) == 1:
        some[:] = True
    result, agree = fit(LeastSquares.of(model, train.only(some), noise.only(some)), starts, loss)
    problem = LeastSquares.of(model, train, noise)
    if not some.all():
        result, _ = fit(problem, result.estimate[None], loss)
    told = Evidence.of(train, noise)
    against_noise = _of_lengths(result, problem, noise, told, loss)
    for _ in range(NOISE_PASSES):
        before, noise = noise, _agreeing(result, problem, noise, told, loss)
        problem = LeastSquares.of(model, train, noise)
        if _alike(noise, before, tolerance):
            result = restated(result, problem)
            break
        result, _ = fit(problem, result.estimate[None], loss)
    return result, noise, against_noise, agree


def _agreeing(result: Fit, problem: LeastSquares, noise: Noise, told: Evidence, loss: Loss) -> Noise:
    """The noise that agrees with what the fit leaves."""
    stacking = problem.stacking
    estimated = noise.estimated
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        own = noise.of_series(k)
        if source == "estimated" and own.any():
            lack = _lack(result, problem, stacking.of_row(own) & ~stacking.angular, told, loss)
            sigma[own] = np.maximum(sigma[own] * np.sqrt(lack.reduced_chi2), LEAST_SCATTER)
    changed = replace(noise, sigma=sigma)
    known = stacking.of_row(~estimated) & ~stacking.angular
    if known.any():
        changed = replace(changed, discrepancy=_lack(result, problem, known, told, loss).discrepancy)
    if stacking.angular.any():
        turned = _lack(result, problem, stacking.angular, told.as_stated, loss)
        changed = replace(changed, rotation_discrepancy=turned.discrepancy)
    return changed


def _of_lengths(result: Fit, problem: LeastSquares, noise: Noise, told: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of the lengths whose noise is known, of all where none is."""
    stacking = problem.stacking
    known = stacking.of_row(~noise.estimated) & ~stacking.angular
    return _lack(result, problem, known if known.any() else ~stacking.angular, told, loss)


def _lack(result: Fit, problem: LeastSquares, which: np.ndarray, told: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of some of the residuals, which bear their share of the parameters."""
    error = (result.residual * problem.total)[which]
    determined = result.effective_parameters * np.count_nonzero(which) / len(which)
    return lack_of_fit(error, problem.sigma[which], determined, problem.stacking.row[which], told, loss != "linear")


def _alike(one: Noise, other: Noise, tolerance: float) -> bool:
    pairs = ((one.total, other.total), (one.total_rotation, other.total_rotation))
    return all(np.allclose(a, b, rtol=tolerance, equal_nan=True) for a, b in pairs if a is not None and b is not None)
