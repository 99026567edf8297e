"""What measurements say alone: an estimate and its covariance once the prior is taken out of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

NOTHING = 1e-10  # information, in the prior's, below which measurements say nothing along a direction


@dataclass(frozen=True)
class Alone:
    """Values (n,) and covariance (n, n) that measurements alone give; prior_sd (n,) is what was known before them.

    Along a direction that the measurements do not determine the variance is NOTHING's inverse in units of the prior's.
    """

    value: np.ndarray
    covariance: np.ndarray
    prior_sd: np.ndarray

    @staticmethod
    def of(estimate: np.ndarray, covariance: np.ndarray, prior_mean: np.ndarray, prior_sd: np.ndarray) -> Alone:
        """Take a normal prior, independent by parameter, out of a normal posterior.

        Its information is the posterior's less the prior's, and what it is weighted with is the posterior's information times
        the estimate less that of the prior (the product of two normal densities, backwards).
        """
        scale = np.outer(prior_sd, prior_sd)
        variance, vectors = eigh(covariance / scale)
        posterior = 1 / np.maximum(variance, np.finfo(float).tiny)
        information = np.maximum(posterior - 1, NOTHING)
        along = vectors.T @ ((estimate - prior_mean) / prior_sd)
        value = prior_mean + prior_sd * (vectors @ (posterior / information * along))
        return Alone(value, scale * ((vectors / information) @ vectors.T), prior_sd)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (n,), whatever the other parameters are."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def told(self) -> np.ndarray:
        """Which parameters (n,) the measurements know better by themselves than the prior did."""
        return self.sd < self.prior_sd
