"""The prior of a type of robots: mean and spread of each parameter, estimated from robots of the type by partial pooling.

In the hierarchical normal model (Gelman et al., Bayesian Data Analysis, ch. 5; here with each robot's full covariance) each
robot's parameters are normal about the type's mean with one spread per parameter. The spreads maximise the marginal likelihood
with the mean integrated out (restricted maximum likelihood), by expectation maximisation; a parameter that no robot determines
keeps the width of its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calflow.population.likelihood import ParameterLikelihood
from calflow.robot.parts import Expected, Parameter

FEWEST_ROBOTS = 5  # robots needed to estimate a spread
SPREAD_ROUNDS = 400
SPREAD_SETTLED = 1e-3  # largest relative change of a spread at convergence
NARROWEST = 1e-4  # least spread, in standard deviations of the prior
COVERED = 0.975
DIGITS = 6  # of what is stated of a further robot
FREE = 1e3  # variance, in those of the prior, of a parameter that deviates from the type


@dataclass(frozen=True, eq=False)
class TypePrior:
    """The type's mean (n,) with its covariance (n, n), and the spread (n,) of its robots, in prior standard deviations.

    squares (n_robots, n) is the posterior expectation of each robot's squared deviation from the mean. own (n_robots, n) marks
    the parameters in which robots deviate from the type; they do not contribute to it.
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
        """Predictive standard deviations (n,) of a further robot's parameters, the uncertainty of the mean included.

        They are widened for a spread estimated from few robots: 95 % of Student's distribution lie within 1.96 of them.
        """
        wider = scipy.stats.t.ppf(COVERED, len(self.likelihoods) - 1) / scipy.stats.norm.ppf(COVERED)
        return np.asarray(wider * np.sqrt(self.spread**2 + np.diag(self.covariance)))

    @property
    def determined(self) -> np.ndarray:
        """Number of robots (n,) whose measurements determine each parameter at least as well as the type does."""
        return np.asarray(sum(_determines(likelihood, self.spread) for likelihood in self.likelihoods))

    def expected(self) -> tuple[Expected, ...]:
        """Return mean and standard deviation of a further robot's parameters, in their own units."""
        return tuple(
            Expected(
                own.effect, own.part, own.symbol, own.unit,
                min(max(_stated(mean * own.prior_sd), own.lower), own.upper), _stated(sd * own.prior_sd),
            )
            for own, mean, sd in zip(self.parameters, self.mean, self.sd, strict=True)
        )  # fmt: skip


def _stated(value: float) -> float:
    """Return a figure in the digits that robots of a type can tell."""
    return float(f"{value:.{DIGITS}g}")


def type_prior(
    parameters: Sequence[Parameter],
    likelihoods: Sequence[ParameterLikelihood],
    own: np.ndarray | None = None,
    start: np.ndarray | None = None,
) -> TypePrior:
    """Return the mean and spread of a type, estimated from the likelihoods of its robots.

    Args:
        parameters: the (n,) parameters of the likelihoods.
        likelihoods: one per robot; fewer than FEWEST_ROBOTS hardly determine a spread.
        own: (n_robots, n) parameters in which a robot deviates from the type, by any amount; by default none.
        start: initial spreads (n,); by default those of the parameters' priors.
    """
    n = len(parameters)
    own = np.zeros((len(likelihoods), n), dtype=bool) if own is None else own
    spread, counted = np.ones(n) if start is None else start, np.maximum(1, (~own).sum(axis=0))
    for _ in range(SPREAD_ROUNDS):
        mean, covariance, squares = _expectation(likelihoods, spread, own)
        new = np.maximum(NARROWEST, np.sqrt(np.where(own, 0.0, squares).sum(axis=0) / counted))
        change, spread = np.abs(new / spread - 1).max(), new
        if change < SPREAD_SETTLED:
            break
    mean, covariance, squares = _expectation(likelihoods, spread, own)
    return TypePrior(tuple(parameters), tuple(likelihoods), mean, covariance, spread, squares, own)


def variances(spread: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the prior variances (n_robots, n) of the robots' parameters: spread (n,) squared, FREE where own (n_robots, n)."""
    return np.where(own, FREE, spread**2)


def pooled_prior(likelihoods: Sequence[ParameterLikelihood], variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each robot's likelihood of the type's mean: information (n_robots, n, n) and pull (n_robots, n).

    variance (n_robots, n) is the prior variance of its parameters about the mean.
    """
    information = np.array([likelihood.information for likelihood in likelihoods])
    pull = np.array([likelihood.pull for likelihood in likelihoods])
    shrink = np.linalg.inv(np.eye(variance.shape[1]) + information * variance[:, None, :])
    return shrink @ information, (shrink @ pull[:, :, None])[:, :, 0]


def _expectation(
    likelihoods: Sequence[ParameterLikelihood], spread: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean (n,), its covariance (n, n), and the expected squared deviations from it (n_robots, n)."""
    variance = variances(spread, own)
    weight, pull = pooled_prior(likelihoods, variance)
    covariance = np.linalg.inv(weight.sum(axis=0) + np.eye(len(spread)))
    mean = covariance @ pull.sum(axis=0)
    deviation = variance * (pull - weight @ mean)
    left = variance - variance**2 * np.diagonal(weight, axis1=1, axis2=2)
    moved = (weight @ covariance * weight.transpose(0, 2, 1)).sum(axis=2)  # by BLAS: einsum takes ten times as long
    return mean, covariance, deviation**2 + left + variance**2 * moved


def _determines(likelihood: ParameterLikelihood, spread: np.ndarray) -> np.ndarray:
    """Return which parameters (n,) a robot's measurements determine at least as well as its type, marginally."""
    posterior = np.linalg.inv(likelihood.information + np.diag(spread**-2.0))
    return np.diag(posterior) < 0.5 * spread**2
