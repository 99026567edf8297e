"""Judgement of rows: which measured rows the identified model does not explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import chi2

from calflow.estimation.accuracy import Residual, errors, residuals
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.estimation.nuisance import completed
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements

FALSE_FLAGS = 0.01  # chance that any good row of a whole data set is flagged


@dataclass(frozen=True, kw_only=True)
class JudgedResidual(Residual):
    """What the identified model leaves of a measured row, and whether that is too much."""

    whitened: float = column("root mean square of the error's parts in standard deviations of noise and discrepancy")
    flagged: bool = column("whether it is too large for noise and for the spread of the rest")


def judged(result: Fit, data: Measurements, noise: Noise) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s; flagged is what noise and the discrepancy of the rest do not explain.

    A training row's residual is studentised by its leverage, so that a row that pulls the fit to itself still shows.
    """
    model, estimate = completed(result.model, result.estimate, data)
    known = [model.parameters.index(parameter) for parameter in result.model.parameters]
    squared, whitened, limit = np.empty(len(data)), np.empty(len(data)), np.empty(len(data))
    for rows, residual, whole in LeastSquares.of(model, data, noise).linearised(estimate):
        jacobian = whole[:, :, known]
        predicted = jacobian @ result.covariance @ jacobian.transpose(0, 2, 1)
        spread = np.eye(residual.shape[1]) + np.where(data.train[rows], -1.0, 1.0)[:, None, None] * predicted
        inverse = np.linalg.pinv(spread, hermitian=True)
        squared[rows] = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        whitened[rows] = np.sqrt((residual**2).mean(axis=1))
        limit[rows] = chi2.isf(FALSE_FLAGS / len(data), residual.shape[1])
    flagged = (squared > limit) & (data.train | data.held_out)
    table = residuals(errors(result.model, result.estimate, data), data)
    return typed(table.assign(whitened=whitened, flagged=flagged), JudgedResidual)
