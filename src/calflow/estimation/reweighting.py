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
    against_noise = _of_leading(result, problem, noise, told, loss)
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
            lack = _lack(result, problem, stacking.of_row(own) & stacking.leading, told, loss)
            sigma[own] = np.maximum(sigma[own] * np.sqrt(lack.reduced_chi2), (LEAST_SCATTER * noise.usual)[own])
    discrepancy = noise.discrepancy
    for unit in problem.units:
        known = stacking.in_unit(unit) & (stacking.of_row(~estimated) | ~stacking.leading)
        if known.any():
            here = told.only_where(noise.in_unit(unit))  # repeats tell the noise of the leading unit alone
            discrepancy = discrepancy.having(unit, _lack(result, problem, known, here, loss).discrepancy)
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


def _of_leading(result: Fit, problem: LeastSquares, noise: Noise, told: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of residuals in their series' leading units whose noise is known, of all such where none is."""
    stacking = problem.stacking
    known = stacking.of_row(~noise.estimated) & stacking.leading
    return _lack(result, problem, known if known.any() else stacking.leading, told, loss)


def _lack(result: Fit, problem: LeastSquares, which: np.ndarray, told: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of some of the residuals, which bear their share of the parameters."""
    error = (result.residual * problem.total)[which]
    determined = result.effective_parameters * np.count_nonzero(which) / len(which)
    return lack_of_fit(error, problem.sigma[which], determined, problem.stacking.row[which], told, loss != "linear")


def _alike(one: Noise, other: Noise, tolerance: float) -> bool:
    pairs = [(one.total, other.total)]
    for (unit, sigma), (_, before) in zip(one.further, other.further, strict=True):
        pairs.append((np.hypot(sigma, one.discrepancy[unit]), np.hypot(before, other.discrepancy[unit])))
    return all(np.allclose(a, b, rtol=tolerance, equal_nan=True) for a, b in pairs)
