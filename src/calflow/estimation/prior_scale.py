"""The scale of priors, as a hyperparameter with a posterior of its own.

A prior's standard deviation describes robots in general. With few data, predictions for one robot depend on it: of a well-made arm
the estimates would deviate from nominal further than the arm does. So the posterior is a mixture over common scales of these
priors, each weighted by its marginal likelihood (MacKay 1992, Bayesian interpolation), in the linearisation at the estimate.

A cause that was found may be far larger than usual, and a normal prior of the usual size would shrink it: of 26 mrad, known to 3,
a prior of 3 leaves 13. So a fit takes the likeliest scale of each cause's priors, one or more, with the tails of a Cauchy
distribution (as the evidence has, see `variance_components`): what is no larger than usual, or is known so well that its prior
hardly matters, is fitted with the usual one.
"""

from __future__ import annotations

import numpy as np
import scipy

from calflow.model import Model

PULLED = 0.1  # standard deviations: a prior that moves an estimate by less is as good as none
ODDS = 3.0  # of a scale over the present one, from which it takes its place: of two that are as likely, none would stay
WIDER = 2.0 ** np.arange(7)  # scales of a cause's priors, over the usual ones
SCALES = 2.0 ** np.arange(-5, 1.5, 0.5)  # factors of the prior standard deviations, equally probable a priori


def strays(model: Model) -> np.ndarray:
    """Return the mask (n_parameters,) of parameters that are deviations of a joint from its nominal figures."""
    return np.array(
        [bool(parameter.joint) and parameter.prior_mean == parameter.nominal for parameter in model.parameters],
        dtype=bool,
    )


def by_scale(
    estimate: np.ndarray,
    covariance: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray],
    scaled: np.ndarray,
    scales: np.ndarray = SCALES,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the posterior of the parameters with some of the priors on each of some equally probable scales, in any units.

    These are the scales' probabilities (n_scales,), and the means (n_scales, n) and covariances (n_scales, n, n) at each.

    Args:
        estimate: the estimate (n,) with the priors as stated.
        covariance: its covariance (n, n), zero for parameters held or at a bound.
        prior: the priors' means and standard deviations, (n,) each.
        scaled: mask (n,) of the parameters whose priors are scaled.
        scales: factors (n_scales,) of their standard deviations.
    """
    mean, sd = prior
    free = np.diag(covariance) > 0
    unit = sd[free]
    off = (estimate - mean)[free] / unit
    # A posterior variance cannot exceed the prior's; excesses by rounding and robust losses are clipped.
    value, axes = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(unit, unit))
    precision = (axes / np.clip(value, np.finfo(float).eps, 1.0)) @ axes.T
    pull, data = precision @ off, precision - np.eye(len(unit))
    means, covariances, evidence = [], [], []
    for scale in scales:
        size = np.where(scaled[free], scale, 1.0)
        # In units of the scaled priors the precision is at least 1, however narrow they are.
        inverse = np.linalg.inv(np.eye(len(unit)) + size[:, None] * data * size)
        posterior = inverse * np.outer(size * unit, size * unit)
        moved = np.zeros(len(estimate))
        moved[free] = posterior @ (pull / unit)
        whole = np.zeros(covariance.shape)
        whole[np.ix_(free, free)] = posterior
        evidence.append(0.5 * (pull / unit) @ moved[free] + 0.5 * np.linalg.slogdet(inverse)[1])
        means.append(np.where(free, mean + moved, estimate))
        covariances.append(whole)
    return scipy.special.softmax(evidence), np.array(means), np.array(covariances)


def on_likeliest_scale(
    estimate: np.ndarray, covariance: np.ndarray, prior: tuple[np.ndarray, np.ndarray], scale: float = 1.0
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the likeliest of the scales `WIDER` of a cause's priors, and its posterior mean and covariance on that scale.

    Arguments are as for `by_scale`, of the cause's parameters alone; scale is the one that they are on, over the usual, and stays
    where that is nearly as good.
    """
    if not np.diag(covariance).any():  # all at bounds
        return scale, estimate, covariance
    probable, means, covariances = by_scale(estimate, covariance, prior, np.full(len(estimate), True), WIDER / scale)
    probable /= WIDER
    best = int(np.argmax(probable))
    apart = np.abs(means[best] - estimate) > PULLED * np.sqrt(np.diag(covariances[best]))
    if not apart.any() or probable[best] < ODDS * probable[scale == WIDER].sum():
        return scale, estimate, covariance
    return float(WIDER[best]), means[best], covariances[best]
