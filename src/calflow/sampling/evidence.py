"""Evidence: the probability of the data under a model, all its parameters integrated out, by importance sampling.

The draws are those of a Student t in the coordinates in which the posterior is round and has no bounds, so that few are enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from calflow.model import Model
from calflow.sampling.posterior import LOG_NOISE_SD, Posterior, drawn_student, log_student

BATCH, MOST_BATCHES = 1000, 8  # draws of a model
EXACT = 0.05  # of the evidence, relative: with less error no more draws are made


@dataclass(frozen=True, eq=False)
class Evidence:
    """The logarithm of a model's evidence, its standard error, and weighted draws of its posterior.

    The evidence is up to a constant that is the same for all models of the same data and weights. values (n, n_parameters + 1)
    are parameters and the log of the noise, weights (n,) add up to 1.
    """

    log: float
    error: float
    values: np.ndarray
    weights: np.ndarray

    def draws(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Return so many draws of the posterior, (number, n_parameters + 1)."""
        return self.values[rng.choice(len(self.weights), size=number, p=self.weights)]


def evidence(posterior: Posterior, rng: np.random.Generator, exact: float = EXACT) -> Evidence:
    """Integrate the posterior of a model over all its parameters and the noise level, until the relative error is below exact."""
    drawn, logs = [], np.zeros(0)
    for _ in range(MOST_BATCHES):
        u = drawn_student((BATCH, posterior.n_dimensions), rng)
        drawn.append(u)
        logs = np.append(logs, posterior.log_probability(u) - log_student(u))
        if _error(logs) < exact:
            break
    level = posterior.coordinates.log_scale - _log_mass(posterior.problem.model)
    weights = np.exp(logs - logsumexp(logs))
    values = posterior.parameters(np.concatenate(drawn))
    return Evidence(float(logsumexp(logs) - np.log(len(logs)) + level), _error(logs), values, weights)


def _error(logs: np.ndarray) -> float:
    """Relative standard error of a mean of weights with these logarithms (n,)."""
    share = np.exp(logs - logsumexp(logs))
    return float(np.sqrt(max((share**2).sum() - 1 / len(share), 0.0)))


def _log_mass(model: Model) -> float:
    """Logarithm of what the prior densities, as the posterior has them, add up to within the bounds."""
    below, above = norm.cdf((model.bounds - model.nominal[:, None]) / model.prior_sd[:, None]).T
    return float(np.log(np.sqrt(2 * np.pi) * np.append(model.prior_sd * (above - below), LOG_NOISE_SD)).sum())
