"""The unnamed rival: whether each cause explains the data better than a background of its own would without it."""

from __future__ import annotations

import numpy as np

from calflow.diagnosis.screening.regressors import Regressors
from calflow.diagnosis.screening.screening import prior_cost
from calflow.diagnosis.search.background import Basis, Sizes
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause

Variants = dict[tuple[str, str], int]


def unnamed(fitted: Fitted, basis: Basis, variants: Variants) -> dict[Cause, float]:
    """Return twice the logarithm by which each cause makes the data more likely than a background in its place does.

    Negative where what nobody can name explains the data better. Each model has the background that suits it best; the cause's
    parameters are integrated out by Laplace's approximation, as the background's amplitudes are, so that a smooth curve of many
    waves and a background of as many are measured alike. variants says how many forms of a place were tried. Linear, without a
    refit.
    """
    if not fitted.causes:
        return {}
    regressors = fitted.alone
    free = np.flatnonzero(~fitted.fit.at_bound)
    value = fitted.fit.estimate[free]
    weight = fitted.problem.weight
    whole = _evidence(regressors, basis, weight)
    covariance = np.linalg.inv(regressors.jacobian.T @ regressors.jacobian + np.diag(regressors.precision))
    found = {}
    for cause in fitted.causes:
        own = np.flatnonzero(np.isin(free, fitted.model.columns(cause)))
        pull = value[own] * np.sqrt(regressors.precision[own])
        without = regressors.without(own, regressors.jacobian[:, own] @ value[own], pull)
        occam = -np.linalg.slogdet(covariance[np.ix_(own, own)] * np.sqrt(np.outer(*2 * [regressors.precision[own]])))[
            1
        ]
        spent = float(occam) + 2 * np.log(variants.get(cause.place, 1))
        unusual = float(pull @ pull - prior_cost(np.array(pull @ pull), len(own)))
        found[cause] = float(_evidence(without, basis, weight) - whole - spent - unusual)
    return found


def _evidence(regressors: Regressors[Cause], basis: Basis, weight: np.ndarray) -> float:
    sizes = Sizes.of(regressors, basis, weight)
    return sizes.evidence(sizes.believed())
