"""Judgement of rows: which measured rows the identified model does not explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import chi2

from calflow.estimation.accuracy import Residual, leading_errors, residuals
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.estimation.nuisance import completed
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements

FALSE_FLAGS = 0.01  # chance that any good row of a whole data set is flagged
TINY = 1e-12  # standard deviations: below it errors are rounding
LEAST_LEFT = 1e-3  # of a row's variance, that a fit leaves


@dataclass(frozen=True, kw_only=True)
class JudgedResidual(Residual):
    """What the identified model leaves of a measured row, and whether that is too much."""

    whitened: float = column("root mean square of the error's parts in standard deviations of noise and discrepancy")
    flagged: bool = column("whether it is too large for noise and for the spread of the rest")


@dataclass(frozen=True)
class Studentised:
    """Residuals of rows over what noise, discrepancy and the fit's own leverage let expect.

    squared (n_rows,) is their square, values (n_rows, n_units) are their parts, nan where a row has fewer; whitened (n_rows,) is
    the root mean square in standard deviations of noise and discrepancy alone.
    """

    squared: np.ndarray
    values: np.ndarray
    whitened: np.ndarray

    @property
    def units(self) -> np.ndarray:
        """How many parts each row has, shape (n_rows,)."""
        return np.asarray((~np.isnan(self.values)).sum(axis=1))

    @staticmethod
    def of(result: Fit, data: Measurements, noise: Noise, far: float = np.inf) -> Studentised:
        """Studentise the residuals of rows by their leverage, so that a row that pulls the fit to itself still shows.

        Rows beyond far robust standard deviations counted in the fit as if they were there (Huber 1964). The variance of a row
        of weight w is 1 + (1 - 2 w) times what the fit is unsure of there; held-out rows have no weight.
        """
        model, estimate = completed(result.model, result.estimate, data)
        known = [model.parameters.index(parameter) for parameter in result.model.parameters]
        squared, whitened = np.empty(len(data)), np.empty(len(data))
        values = np.full((len(data), max(len(one.units) for one in model.observations)), np.nan)
        for rows, residual, _ in LeastSquares.of(model, data, noise).linearised(estimate):
            whitened[rows] = np.sqrt((residual**2).mean(axis=1))
        usual = max(float(np.median(whitened[data.train])), TINY)
        weight = np.where(data.train, np.minimum(1.0, far * usual / np.maximum(whitened, TINY)) ** 2, 0.0)
        for rows, residual, whole in LeastSquares.of(model, data, noise).linearised(estimate):
            jacobian = whole[:, :, known]
            predicted = jacobian @ result.covariance @ jacobian.transpose(0, 2, 1)
            spread = np.eye(residual.shape[1]) + (1 - 2 * weight[rows])[:, None, None] * predicted
            inverse = np.linalg.pinv(spread, hermitian=True)
            squared[rows] = np.maximum(np.einsum("ni,nij,nj->n", residual, inverse, residual), 0.0)
            sd = np.sqrt(np.maximum(np.einsum("nii->ni", spread), LEAST_LEFT))
            values[np.asarray(rows)[:, None], np.arange(residual.shape[1])] = residual / sd
        return Studentised(squared, values, whitened)


def judged(result: Fit, data: Measurements, noise: Noise) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s; flagged is what noise and the discrepancy of the rest do not explain."""
    found = Studentised.of(result, data, noise)
    limit = chi2.isf(FALSE_FLAGS / len(data), found.units)
    return judged_table(result, data, found, (found.squared > limit) & (data.train | data.held_out))


def judged_table(result: Fit, data: Measurements, found: Studentised, flagged: np.ndarray) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s with the rows (n_rows,) that are flagged."""
    table = residuals(leading_errors(result.model, result.estimate, data), data)
    return typed(table.assign(whitened=found.whitened, flagged=flagged), JudgedResidual)
