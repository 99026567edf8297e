"""A Gaussian process for what no cause explains: it predicts, without a physical meaning, and is never part of the model.

A decoy's waves with independent normal amplitudes of one size are a Gaussian process over its inputs that acts where the decoy
does (the weight-space view: Rasmussen and Williams 2006, 2.1). The size is that of the greatest marginal likelihood, the
noise's level integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calflow.diagnosis.screening.screening import Screening
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects import Effect
from calflow.estimation.accuracy import error_jacobian
from calflow.measurements.measurements import Measurements

SIZES = np.concatenate([[0.0], np.geomspace(0.01, 10.0, 61)])  # over the prior's, that are tried


def predicted(fitted: Fitted, decoys: Sequence[Effect], data: Measurements) -> np.ndarray:
    """Return by how much the process moves what is predicted of rows, shape (n_rows, 3) [m]: see `errors`.

    The model's own parameters settle beside it, as far as their priors let them.
    """
    regressors = replace(fitted, background=None).regressors(decoys)
    amplitudes = _amplitudes(Screening(regressors)) * regressors.prior_sd
    own = regressors.jacobian
    imitated = own.T @ regressors.matrix.times(amplitudes)
    settled = -np.linalg.solve(own.T @ own + np.diag(regressors.precision), imitated)
    model, fit = fitted.model, fitted.fit
    both = replace(model, probes=tuple(decoys))
    change = np.zeros(len(both.parameters))
    change[np.flatnonzero(~fit.at_bound)] = settled
    change[len(fit.estimate) :] = amplitudes
    at = np.append(fit.estimate, both.nominal[len(fit.estimate) :])
    return error_jacobian(both, at, data) @ change


def _amplitudes(screening: Screening) -> np.ndarray:
    """The most probable amplitudes of all columns, over their priors."""
    sd = screening.regressors.prior_sd
    shown = screening.information(np.arange(len(sd))) * sd[:, None] * sd
    values, vectors = np.linalg.eigh(shown)
    values = np.maximum(values, 0.0)
    score = vectors.T @ (screening.score * sd)
    square = SIZES[:, None] ** 2
    kept = square / (1 + square * values)  # (n_sizes, n_columns)
    drop = kept @ score**2
    evidence = -0.5 * (
        screening.degrees_of_freedom * np.log1p(-np.minimum(drop / screening.chi2, 1 - 1e-12))
        + np.log1p(square * values).sum(axis=1)
    )
    return np.asarray(-vectors @ (kept[int(np.argmax(evidence))] * score))
