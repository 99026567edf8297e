"""The prior of a type of robots: mean and spread of each parameter, estimated from robots of the type by partial pooling.

Each robot's parameters are normal about the type's mean with a spread of each parameter's own, of which the robots'
measurements tell: the hierarchical normal model (Gelman et al., Bayesian Data Analysis, ch. 5; here with each robot's whole
covariance). The spreads are of largest marginal likelihood, found by expectation maximisation with the mean integrated out
(restricted maximum likelihood), so that what no robot determines stays as wide as the prior that it had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calflow.population.likelihood import ParameterLikelihood
from calflow.robot.parts import Expected, Parameter

FEWEST = 5  # robots, of which fewer say nothing of a spread
ROUNDS = 400
SETTLED = 1e-3  # relative change of every spread in a round
NARROWEST = 1e-4  # spread, as a part of the prior's standard deviation
COVERED = 0.975
FREE = 1e3  # variance, in those of the prior, of what is taken to be unlike the type


@dataclass(frozen=True, eq=False)
class TypePrior:
    """The type's mean (n,) with its covariance (n, n), and the spread (n,) of its robots, in standard deviations of the priors.

    squares (n_robots, n) is what each robot adds to the spread: its squared deviation as far as it is known, and beyond that what
    it may be. own (n_robots, n) marks parameters in which robots are unlike the type: they tell it nothing.
    """

    parameters: tuple[Parameter, ...]
    likelihoods: tuple[ParameterLikelihood, ...]
    mean: np.ndarray
    covariance: np.ndarray
    spread: np.ndarray
    squares: np.ndarray
    own: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of a further robot's parameters about the mean, that of the mean included (n,).

        A spread known from few robots counts for more: 95 % of Student's distribution are within 1.96 of these.
        """
        wider = scipy.stats.t.ppf(COVERED, len(self.likelihoods) - 1) / scipy.stats.norm.ppf(COVERED)
        return np.asarray(wider * np.sqrt(self.spread**2 + np.diag(self.covariance)))

    @property
    def determined(self) -> np.ndarray:
        """Of each parameter how many robots tell of it at least as much as the type does (n,)."""
        return np.asarray(sum(_determines(likelihood, self.spread) for likelihood in self.likelihoods))

    def expected(self) -> tuple[Expected, ...]:
        """Return what is expected of a further robot's parameters, in their own units."""
        return tuple(
            Expected(parameter.effect, parameter.part, parameter.symbol, parameter.unit,
                     float(np.clip(mean * parameter.prior_sd, parameter.lower, parameter.upper)), float(sd * parameter.prior_sd))
            for parameter, mean, sd in zip(self.parameters, self.mean, self.sd, strict=True)
        )  # fmt: skip


def type_prior(
    parameters: Sequence[Parameter],
    likelihoods: Sequence[ParameterLikelihood],
    own: np.ndarray | None = None,
    start: np.ndarray | None = None,
) -> TypePrior:
    """Estimate mean and spread of a type from what its robots' measurements tell.

    Args:
        parameters: (n,) of which they tell.
        likelihoods: of each robot; fewer than FEWEST say little of a spread.
        own: (n_robots, n) parameters in which a robot is unlike the type, whatever its deviation; none where nothing is said.
        start: spreads (n,) to begin with; those of the parameters' priors where nothing is said.
    """
    n = len(parameters)
    own = np.zeros((len(likelihoods), n), dtype=bool) if own is None else own
    spread, counted = np.ones(n) if start is None else start, np.maximum(1, (~own).sum(axis=0))
    for _ in range(ROUNDS):
        mean, covariance, squares = _expectation(likelihoods, spread, own)
        new = np.maximum(NARROWEST, np.sqrt(np.where(own, 0.0, squares).sum(axis=0) / counted))
        change, spread = np.abs(new / spread - 1).max(), new
        if change < SETTLED:
            break
    mean, covariance, squares = _expectation(likelihoods, spread, own)
    return TypePrior(tuple(parameters), tuple(likelihoods), mean, covariance, spread, squares, own)


def variances(spread: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return what each robot's parameters may vary by (n_robots, n), of spreads (n,) and what is their own (n_robots, n)."""
    return np.where(own, FREE, spread**2)


def pooled_prior(likelihoods: Sequence[ParameterLikelihood], variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what each robot tells of the type's mean: information (n_robots, n, n) and pull (n_robots, n).

    variance (n_robots, n) is by how much its parameters may differ from the mean.
    """
    information = np.array([likelihood.information for likelihood in likelihoods])
    pull = np.array([likelihood.pull for likelihood in likelihoods])
    shrink = np.linalg.inv(np.eye(variance.shape[1]) + information * variance[:, None, :])
    return shrink @ information, (shrink @ pull[:, :, None])[:, :, 0]


def _expectation(
    likelihoods: Sequence[ParameterLikelihood], spread: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean (n,), its covariance (n, n), and the expected squares of the deviations from it (n_robots, n)."""
    variance = variances(spread, own)
    weight, pull = pooled_prior(likelihoods, variance)
    covariance = np.linalg.inv(weight.sum(axis=0) + np.eye(len(spread)))
    mean = covariance @ pull.sum(axis=0)
    deviation = variance * (pull - weight @ mean)
    left = variance - variance**2 * np.diagonal(weight, axis1=1, axis2=2)
    moved = (weight @ covariance * weight.transpose(0, 2, 1)).sum(axis=2)  # by BLAS: einsum takes ten times as long
    return mean, covariance, deviation**2 + left + variance**2 * moved


def _determines(likelihood: ParameterLikelihood, spread: np.ndarray) -> np.ndarray:
    """Whether a robot tells of each parameter at least as much as its type does, whatever the others are (n,)."""
    posterior = np.linalg.inv(likelihood.information + np.diag(spread**-2.0))
    return np.diag(posterior) < 0.5 * spread**2
