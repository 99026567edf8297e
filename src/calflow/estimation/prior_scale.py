"""The scale of the priors: what the parameters may be where joints stray less, or more, from their maker's figures than is usual.

A prior's standard deviation says what is usual of robots at large. Where the data tell little, what is promised of this one
depends on it: of an arm made well, few data give estimates that stray further than the arm does. The data also tell, by their
evidence, on what scale its joints stray; each scale counts as far as it is probable (an empirical Bayes in one hyperparameter,
MacKay 1992, Bayesian interpolation), on the linearisation at the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.model import Model

SCALES = 2.0 ** np.arange(-5, 1.5, 0.5)  # of standard deviations, all as probable before the data


@dataclass(frozen=True, eq=False)
class AtScale:
    """What data tell of parameters whose priors are on a scale: how probable that is, their mean (n,) and covariance (n, n)."""

    scale: float
    probability: float
    mean: np.ndarray
    covariance: np.ndarray


def strays(model: Model) -> np.ndarray:
    """Which parameters say how a joint strays from its maker's figures, shape (n_parameters,)."""
    return np.array(
        [bool(parameter.joint) and parameter.prior_mean == parameter.nominal for parameter in model.parameters],
        dtype=bool,
    )


def by_scale(
    estimate: np.ndarray, covariance: np.ndarray, prior: tuple[np.ndarray, np.ndarray], scaled: np.ndarray
) -> tuple[AtScale, ...]:
    """Return the parameters given the data with some priors on each of `SCALES`, in any units.

    Args:
        estimate: the parameters with the priors as stated, (n,); covariance (n, n) of those held, or at a bound, is zero.
        prior: their means and standard deviations, (n,).
        scaled: of which the priors are scaled, (n,).
    """
    mean, sd = prior
    free = np.diag(covariance) > 0
    unit = sd[free]
    off = (estimate - mean)[free] / unit
    # Nothing is less sure with data than without; what rounding and robust losses leave of that is cut.
    value, axes = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(unit, unit))
    precision = (axes / np.clip(value, np.finfo(float).eps, 1.0)) @ axes.T
    pull, data = precision @ off, precision - np.eye(len(unit))
    scales, evidence = [], []
    for scale in SCALES:
        size = np.where(scaled[free], scale, 1.0)
        # In units of the scaled priors, where the precision is 1 at least, however narrow they are.
        inverse = np.linalg.inv(np.eye(len(unit)) + size[:, None] * data * size)
        posterior = inverse * np.outer(size * unit, size * unit)
        moved = np.zeros(len(estimate))
        moved[free] = posterior @ (pull / unit)
        whole = np.zeros(covariance.shape)
        whole[np.ix_(free, free)] = posterior
        evidence.append(0.5 * (pull / unit) @ moved[free] + 0.5 * np.linalg.slogdet(inverse)[1])
        scales.append((np.where(free, mean + moved, estimate), whole))
    weight = np.exp(np.array(evidence) - max(evidence))
    return tuple(
        AtScale(float(scale), float(share), *posterior)
        for scale, share, posterior in zip(SCALES, weight / weight.sum(), scales, strict=True)
    )
