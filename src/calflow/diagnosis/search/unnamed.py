"""The unnamed rival: whether each cause explains the data better than a background of its own would without it."""

from __future__ import annotations

from collections.abc import Collection

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
    waves and a background of as many are measured alike. A background of an input of which the cause is any smooth function would
    be the same under no name, and is no rival. variants says how many forms of a place were tried. Linear, without a
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
        without = regressors.without(own, value[own])
        spent = _occam(covariance, regressors.precision, own) + 2 * np.log(variants.get(cause.place, 1))
        other = _evidence(without, basis, weight, cause.effect.smooth_in)
        found[cause] = float(other - whole - spent - _unusual(pull))
    return found


def evidence(fitted: Fitted, basis: Basis, variants: Variants) -> float:
    """Return twice minus the logarithm of a model's likelihood beside the background that suits it best, causes integrated out."""
    regressors, free = fitted.alone, np.flatnonzero(~fitted.fit.at_bound)
    weight = fitted.problem.weight  # each fit has its own, by the noise that it leaves
    whole = _evidence(regressors, basis, weight) - 2 * float(np.log(weight).sum())
    value, precision = fitted.fit.estimate[free], regressors.precision
    covariance = np.linalg.inv(regressors.jacobian.T @ regressors.jacobian + np.diag(precision))
    columns = [np.flatnonzero(np.isin(free, fitted.model.columns(cause))) for cause in fitted.causes]
    spent = sum(2 * np.log(variants.get(cause.place, 1)) for cause in fitted.causes)
    return (
        whole
        + _occam(covariance, precision, np.concatenate([[], *columns]).astype(int))
        + float(spent)
        + sum(_unusual(value[own] * np.sqrt(precision[own])) for own in columns)
    )


def _occam(covariance: np.ndarray, precision: np.ndarray, own: np.ndarray) -> float:
    """What it costs to have parameters with these columns: how much smaller than their priors they have become, -2 log."""
    scale = np.sqrt(precision[own])
    return -float(np.linalg.slogdet(covariance[np.ix_(own, own)] * np.outer(scale, scale))[1])


def _unusual(pull: np.ndarray) -> float:
    """What their sizes cost beyond that, in priors' standard deviations."""
    return float(pull @ pull - prior_cost(np.array(pull @ pull), len(pull)))


def _evidence(regressors: Regressors[Cause], basis: Basis, weight: np.ndarray, without: Collection[str] = ()) -> float:
    sizes = Sizes.of(regressors, basis, weight)
    return sizes.evidence(sizes.believed(without))
