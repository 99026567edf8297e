"""The posterior in coordinates that make it round, and the moves that sample it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import emcee
import numpy as np
from scipy.special import gammaln

from calflow.compiled import compiled
from calflow.estimation.calibrated import Identified
from calflow.estimation.least_squares import LeastSquares, SeriesBlock
from calflow.estimation.repeats import averaged
from calflow.measurements.measurements import Measurements

LOG_NOISE_SD = 1.0  # prior on the log of the noise level: a factor e either way
VARIANCE_PASSES = 3  # the noise level and the number of parameters it leaves undetermined depend on each other, weakly
DEGREES = 8.0  # of the Student t that proposes: tails heavy enough to reach what Laplace's normal would miss
EXPECTED_EVALUATIONS = 10_000  # of each row: sampling always pays for compiling


@dataclass(frozen=True)
class Laplace:
    """A normal approximation about the estimate: covariance (n, n) of the parameters off their bounds.

    variance is the noise's, relative to the problem's weights. A parameter at a bound stands in the covariance by
    itself, with the variance that it would have if all others were known.
    """

    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    variance: float

    @staticmethod
    def of(problem: LeastSquares, estimate: np.ndarray, at_bound: np.ndarray) -> Laplace:
        """Approximate the posterior of a problem at its estimate; the noise level is what the fit leaves."""
        residual, r_factor = problem.reduced(estimate)
        scaled = r_factor * problem.model.prior_sd
        free = ~at_bound
        variance = 1.0
        for _ in range(VARIANCE_PASSES):
            information = scaled.T @ scaled / variance + np.eye(len(estimate))
            inverse = np.linalg.inv(information[np.ix_(free, free)])
            determined = len(inverse) - np.trace(inverse)
            variance = float((residual**2).sum() / max(1.0, residual.size - determined))
        covariance = np.diag(np.where(free, 0.0, 1 / np.diag(information)))
        covariance[np.ix_(free, free)] = inverse
        return Laplace(
            estimate, covariance * np.outer(problem.model.prior_sd, problem.model.prior_sd), at_bound, variance
        )


@dataclass(frozen=True)
class Posterior:
    """Log posterior of the parameters and the log of the noise level, as a function of scaled coordinates.

    x = centre + factor @ u, factor being the Cholesky factor of Laplace's covariance; u and x have n_parameters + 1
    entries, the last for the log of the noise relative to the problem's weights. folded marks the coordinates that
    begin at a bound: they are positive.
    """

    problem: LeastSquares
    centre: np.ndarray
    factor: np.ndarray
    folded: np.ndarray

    @staticmethod
    def about(problem: LeastSquares, laplace: Laplace) -> Posterior:
        """Scale by Laplace's approximation; a coordinate of a parameter at a bound counts from there inwards."""
        centre = np.append(laplace.estimate, 0.5 * np.log(laplace.variance))
        n = len(laplace.estimate)
        factor = np.zeros((n + 1, n + 1))
        free = ~laplace.at_bound
        sd = np.sqrt(np.diag(laplace.covariance))
        scaled = laplace.covariance[np.ix_(free, free)] / np.outer(sd[free], sd[free])
        factor[np.ix_(np.append(free, False), np.append(free, False))] = np.linalg.cholesky(scaled) * sd[free][:, None]
        lower, upper = problem.model.bounds.T
        at_lower = laplace.estimate - lower < upper - laplace.estimate
        for i in np.flatnonzero(laplace.at_bound):
            centre[i] = lower[i] if at_lower[i] else upper[i]
            factor[i, i] = sd[i] if at_lower[i] else -sd[i]
        factor[-1, -1] = 1 / np.sqrt(2 * problem.size)
        return Posterior(problem, centre, factor, np.append(laplace.at_bound, False))

    @cached_property
    def squares(self) -> Callable[[np.ndarray], np.ndarray]:
        """The function (n_parameters, n_walkers) -> sum of squared whitened residuals (n_walkers,)."""
        return _sum_of_squares(self.problem)

    @property
    def n_dimensions(self) -> int:
        """Number of coordinates."""
        return len(self.centre)

    def parameters(self, u: np.ndarray) -> np.ndarray:
        """Return the parameters and the log noise level for coordinates (..., n_dimensions)."""
        return self.centre + u @ self.factor.T

    def log_densities(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return log prior and log likelihood, each (n_walkers,) and up to a constant, of coordinates (n_walkers, n_dimensions).

        Outside the bounds the prior's is -inf, and the likelihood, which is not evaluated there, 0.
        """
        x = self.parameters(u)
        model = self.problem.model
        values, log_noise = x[:, :-1], x[:, -1]
        lower, upper = model.bounds.T
        inside = ((values >= lower) & (values <= upper)).all(axis=1)
        prior, likelihood = np.full(len(x), -np.inf), np.zeros(len(x))
        if inside.any():
            values, log_noise = values[inside], log_noise[inside]
            scaled = (values - model.prior_mean) / model.prior_sd
            prior[inside] = -0.5 * (scaled**2).sum(axis=1) - 0.5 * (log_noise / LOG_NOISE_SD) ** 2
            likelihood[inside] = -0.5 * self.squares(values.T) * np.exp(-2 * log_noise) - self.problem.size * log_noise
        return prior, likelihood

    def log_probability(self, u: np.ndarray) -> np.ndarray:
        """Return the log posterior, up to a constant, of coordinates (n_walkers, n_dimensions); -inf outside bounds."""
        prior, likelihood = self.log_densities(u)
        return prior + likelihood

    def start(self, n_walkers: int, rng: np.random.Generator) -> np.ndarray:
        """Return walkers (n_walkers, n_dimensions) drawn from Laplace's normal, redrawn until all are inside the bounds."""
        walkers = _fold(rng.standard_normal((n_walkers, self.n_dimensions)), self.folded)
        for _ in range(200):
            outside = ~np.isfinite(self.log_probability(walkers))
            if not outside.any():
                return walkers
            walkers[outside] = _fold(rng.standard_normal((int(outside.sum()), self.n_dimensions)), self.folded)
        raise RuntimeError("no start inside the bounds: Laplace's approximation lies outside them almost everywhere")


def moves(folded: np.ndarray, independent: float) -> list[tuple[emcee.moves.Move, float]]:
    """Return the mixture of moves: an independent Student t in Laplace's coordinates, and differential evolution.

    folded (n_dimensions,) marks positive coordinates, independent is the share of the first move. `DESnookerMove` is left
    out on purpose: in emcee 3.1.6 its acceptance lacks a factor and it samples too narrow a posterior.
    """
    mixture = [
        (emcee.moves.MHMove(student_proposal(folded)), independent),
        (emcee.moves.DEMove(), 1 - independent),
    ]
    return [(move, weight) for move, weight in mixture if weight > 0]


def student_proposal(folded: np.ndarray) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Return emcee's proposal function for an independent multivariate Student t with unit scale.

    Folding a coordinate doubles the density everywhere, which leaves its ratio as it is.
    """
    n_dimensions = len(folded)

    def log_density(u: np.ndarray) -> np.ndarray:
        constant = (
            gammaln((DEGREES + n_dimensions) / 2) - gammaln(DEGREES / 2) - 0.5 * n_dimensions * np.log(DEGREES * np.pi)
        )
        return constant - 0.5 * (DEGREES + n_dimensions) * np.log1p((u**2).sum(axis=1) / DEGREES)

    def propose(u: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        mixing = rng.chisquare(DEGREES, size=(len(u), 1)) / DEGREES
        proposed = _fold(rng.standard_normal(u.shape) / np.sqrt(mixing), folded)
        return proposed, log_density(u) - log_density(proposed)

    return propose


def _fold(u: np.ndarray, folded: np.ndarray) -> np.ndarray:
    return np.where(folded, np.abs(u), u)


def _sum_of_squares(problem: LeastSquares) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function (n_parameters, n_walkers) -> sum of squared whitened residuals (n_walkers,)."""
    blocks = [_squares_of(block) for block in problem.blocks]

    def squares(values: np.ndarray) -> np.ndarray:
        return np.sum([block(values) for block in blocks], axis=0)

    return squares


def _squares_of(block: SeriesBlock) -> Callable[[np.ndarray], np.ndarray]:
    n_rows = len(block.rows)
    inputs, residual = block.expression()
    row = compiled(ca.Function("squares", inputs, [ca.sumsqr(residual)]), EXPECTED_EVALUATIONS * n_rows)
    data = [np.asfortranarray(part) for part in block.data]
    over_rows = row.map("rows", "serial", n_rows, [0], [])
    mapped: dict[int, ca.Function] = {}

    def squares(values: np.ndarray) -> np.ndarray:
        n_walkers = values.shape[1]
        if n_walkers not in mapped:
            mapped[n_walkers] = over_rows.map("walkers", "serial", n_walkers, [1, 2, 3], [])
        return np.asarray(mapped[n_walkers](values, *data)).reshape(n_walkers, n_rows).sum(axis=1)

    return squares


def posterior_of(known: Identified, data: Measurements) -> tuple[Posterior, Laplace]:
    """Return the posterior of what was identified, given the training rows, and its approximation."""
    means = averaged(data.only(data.train), known.noise(data).only(data.train))
    problem = LeastSquares.of(known.model, *means).reweighted(known.estimate, known.loss)
    laplace = Laplace.of(problem, known.estimate, known.at_bound)
    return Posterior.about(problem, laplace), laplace
