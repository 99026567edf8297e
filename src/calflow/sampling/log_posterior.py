"""The log posterior in unbounded coordinates in which it is nearly a standard normal, and the moves that sample it.

The coordinates map a standard normal onto Laplace's normal approximation, truncated at the parameters' bounds. Parameters near a
bound come first, each a truncated normal conditional on those before it: the triangular map of the GHK sampler (Geweke 1991;
Hajivassiliou and McFadden 1998). All other parameters are linear in the coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import scipy

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import averaged
from calflow.measurements.measurements import Measurements
from calflow.model import bound_to_rows, compiled

if TYPE_CHECKING:
    from emcee.moves import Move

Squares = Callable[[np.ndarray], np.ndarray]
NEAR_BOUND = 5.0  # distance from a bound, in standard deviations of the fit, within which a parameter is transformed
LOG_NOISE_SD = 1.0  # prior sd of the log of the noise level: a factor e either way
EXPECTED_EVALUATIONS = 10_000  # per row: sampling always pays for compiling


@dataclass(frozen=True)
class Coordinates:
    """The map from coordinates u (..., n) to parameters x (..., n).

    Parameter number order[k] is mean[k] + factor[k] @ z, factor (n, n) lower triangular; for the first n_cut parameters z[k] is
    u[k] mapped into the bounds lower and upper (n_cut,), for the others z[k] = u[k].
    """

    order: np.ndarray
    mean: np.ndarray
    factor: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def about(estimate: np.ndarray, mean: np.ndarray, covariance: np.ndarray, bounds: np.ndarray) -> Coordinates:
        """Return the coordinates of a normal (mean, covariance) truncated at bounds (n, 2), with its mode at the estimate."""
        sd = np.sqrt(np.diag(covariance))
        near = (np.abs(bounds - estimate[:, None]) < NEAR_BOUND * sd[:, None]).any(axis=1)
        inside = np.diff(scipy.stats.norm.cdf((bounds - mean[:, None]) / sd[:, None]), axis=1).ravel()
        order = np.lexsort((inside, ~near))  # the most truncated parameters are drawn first
        scaled = covariance[np.ix_(order, order)] / np.outer(sd[order], sd[order])
        factor = np.linalg.cholesky(scaled) * sd[order][:, None]
        cut = order[: np.count_nonzero(near)]
        return Coordinates(order, mean[order], factor, *bounds[cut].T)

    @property
    def n_cut(self) -> int:
        return len(self.lower)

    @property
    def cut(self) -> np.ndarray:
        return self.order[: self.n_cut]

    def mapped(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x (..., n) and log |dx/du| (...), without the constant of the linear part, for u (..., n)."""
        z = np.array(u)
        log_slope = np.zeros(u.shape[:-1])
        for k in range(self.n_cut):
            # The bounds of z[k], conditional on those before it.
            middle = self.mean[k] + z[..., :k] @ self.factor[k, :k]
            least, most = ((bound[k] - middle) / self.factor[k, k] for bound in (self.lower, self.upper))
            z[..., k], slope = _truncated(u[..., k], least, most)
            log_slope += slope
        x = np.empty_like(z)
        x[..., self.order] = self.mean + z @ self.factor.T
        x[..., self.cut] = np.clip(x[..., self.cut], self.lower, self.upper)  # removes round-off beyond the bounds
        return x, log_slope


def _truncated(u: np.ndarray, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map a standard normal variate to one truncated at least and most; also return the logarithm of the derivative."""
    # An interval mostly above zero is reflected: the normal's log cdf is accurate in the lower tail.
    reflect = least + most > 0
    sign, low, high = np.where(reflect, -1.0, 1.0), np.where(reflect, -most, least), np.where(reflect, -least, most)
    log_cdf = scipy.special.log_ndtr
    below, top = log_cdf(low), log_cdf(high)
    z = sign * scipy.special.ndtri_exp(np.logaddexp(below + log_cdf(-sign * u), top + log_cdf(sign * u)))
    with np.errstate(divide="ignore"):
        log_mass = top + np.log(-np.expm1(np.minimum(below - top, 0.0)))
    return z, (z**2 - u**2) / 2 + log_mass


@dataclass(frozen=True)
class Laplace:
    """Laplace's normal approximation of the unbounded posterior, expanded about the estimate within the bounds.

    mean (n,) and covariance (n, n) are the normal's; the mean lies beyond an active bound. sd (n,) are the fit's standard
    deviations, with parameters at a bound held fixed (sd 0). least is the sum of squared residuals at the estimate; variance that
    of the noise relative to the problem's weights.
    """

    estimate: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    sd: np.ndarray
    least: float
    variance: float

    @staticmethod
    def of(problem: LeastSquares, estimate: np.ndarray) -> Laplace:
        """Return the approximation of a problem's posterior about its estimate, the noise level from the residuals."""
        there, prior_sd = Fit.at(problem, estimate), problem.model.prior_sd
        pull, prior = (estimate - problem.model.prior_mean) / prior_sd, np.diag(prior_sd**-2.0)
        scale = np.outer(prior_sd, prior_sd)
        least = float(2 * there.objective - pull @ pull)
        variance = least / max(1.0, problem.size - there.effective_parameters)
        at_level = replace(there, information=prior + (there.information - prior) / variance)
        covariance = np.linalg.inv(at_level.information * scale) * scale
        gradient = ((there.gradient * prior_sd - pull) / variance + pull) / prior_sd
        sd = np.sqrt(np.diag(at_level.covariance))
        return Laplace(estimate, estimate - covariance @ gradient, covariance, sd, least, variance)

    def beside_smooth_errors(self, covariance: np.ndarray) -> Laplace:
        """Return the approximation with the posterior covariance (n, n) beside smooth errors, zero for held parameters.

        These keep their own information; their correlations are transformed along with the other parameters.
        """
        scale, free = np.sqrt(np.diag(self.covariance)), np.flatnonzero(np.diag(covariance))
        squares, block = np.outer(scale, scale), np.ix_(free, free)
        information, precision = np.linalg.inv(self.covariance / squares), np.linalg.inv((covariance / squares)[block])
        transform = np.eye(len(scale))
        transform[block] = np.linalg.cholesky(precision) @ np.linalg.inv(np.linalg.cholesky(information[block]))
        inverse = np.linalg.inv(transform @ information @ transform.T)
        mean = self.estimate - scale * (inverse @ information @ ((self.estimate - self.mean) / scale))
        return replace(self, mean=mean, covariance=inverse * squares, sd=np.sqrt(np.diag(covariance)))

    def squares(self, problem: LeastSquares) -> Squares:
        """Return a quadratic in place of `_sum_of_squares` whose posterior is this normal; it equals that at the estimate."""
        scale = np.sqrt(np.diag(self.covariance))
        precision = np.linalg.inv(self.covariance / np.outer(scale, scale))

        def quadratic(values: np.ndarray) -> np.ndarray:
            deviation = (values - self.mean) / scale
            prior = (values - problem.model.prior_mean) / problem.model.prior_sd
            return np.asarray(((deviation @ precision) * deviation - prior**2).sum(axis=-1))

        at_estimate = quadratic(self.estimate)
        return lambda values: self.least + self.variance * (quadratic(values.T) - at_estimate)


@dataclass(frozen=True)
class LogPosterior:
    """Log posterior of the parameters and the log noise level, as a function of coordinates in which it is nearly standard normal.

    Parameters and coordinates have n_parameters + 1 entries, the last for the log of the noise relative to the problem's weights.
    squares is the function (n_parameters, n_walkers) -> sum of squared whitened residuals (n_walkers,).
    """

    problem: LeastSquares
    coordinates: Coordinates
    squares: Squares

    @staticmethod
    def about(problem: LeastSquares, laplace: Laplace, squares: Squares | None = None) -> LogPosterior:
        """Return the log posterior in the coordinates in which Laplace's normal, truncated at the bounds, is standard normal."""
        n = len(laplace.estimate)
        middle = 0.5 * np.log(laplace.variance)
        covariance = np.zeros((n + 1, n + 1))
        covariance[:n, :n], covariance[n, n] = laplace.covariance, 1 / (2 * problem.size)
        bounds = np.vstack([problem.model.bounds, (-np.inf, np.inf)])
        estimate, mean = np.append(laplace.estimate, middle), np.append(laplace.mean, middle)
        coordinates = Coordinates.about(estimate, mean, covariance, bounds)
        return LogPosterior(problem, coordinates, squares or _sum_of_squares(problem))

    @property
    def n_dimensions(self) -> int:
        return len(self.coordinates.mean)

    def parameters(self, u: np.ndarray) -> np.ndarray:
        """Return the parameters and the log noise level for coordinates (..., n_dimensions)."""
        return self.coordinates.mapped(u)[0]

    def densities_at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return log prior and log likelihood (n_walkers,), up to constants, of parameters; -inf and 0 beyond bounds."""
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

    def densities(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the log posterior (n_walkers,) of coordinates, with the map's log Jacobian, and log prior and likelihood there."""
        x, log_slope = self.coordinates.mapped(u)
        prior, likelihood = self.densities_at(x)
        return prior + likelihood + log_slope, prior, likelihood


def move_mixture(independent: float) -> list[tuple[Move, float]]:
    """Return the mixture of moves: a share of independence proposals (Student t in u), and differential evolution.

    `DESnookerMove` is omitted on purpose: in emcee 3.1.6 its acceptance lacks a factor, so that its posterior is too narrow.
    """
    from emcee.moves import DEMove, MHMove

    mixture = [(MHMove(propose_student), independent), (DEMove(), 1 - independent)]
    return [(move, weight) for move, weight in mixture if weight > 0]


def propose_student(u: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
    """Return draws (n_walkers, n_dimensions) of a multivariate Student t of unit scale, and log Hastings ratios for emcee."""
    # Heavier tails than a normal's; with fewer degrees of freedom, radii in many dimensions would differ from its.
    degrees = 2 * u.shape[1]
    mixing = rng.chisquare(degrees, size=(len(u), 1)) / degrees
    proposed = rng.standard_normal(u.shape) / np.sqrt(mixing)
    fallen = np.log1p((proposed**2).sum(axis=1) / degrees) - np.log1p((u**2).sum(axis=1) / degrees)
    return proposed, 0.5 * (degrees + u.shape[1]) * fallen


def _sum_of_squares(problem: LeastSquares) -> Squares:
    """Return the function (n_parameters, n_walkers) -> sum of squared whitened, decorrelated residuals (n_walkers,)."""
    every = []
    for block in problem.blocks:
        inputs, residual = block.expression()
        row = compiled(ca.Function("residual", inputs, [residual]), EXPECTED_EVALUATIONS * len(block.rows))
        every.append((block, bound_to_rows(row, *block.data)))

    def squares(values: np.ndarray) -> np.ndarray:
        found = np.zeros(values.shape[1])
        for block, at in every:
            errors = (block.decorrelated(at(point)[0].T) for point in values.T)
            found += [np.vdot(error, error) for error in errors]
        return found

    return squares


def log_posterior_of(calibrated: CalibratedModel, data: Measurements) -> tuple[LogPosterior, Laplace]:
    """Return the posterior of the identified model, given the training rows, and its Laplace approximation.

    If the model leaves smooth errors, the likelihood that allows for them is linearised at the estimate as a whole: a sum of
    squares linearised in part becomes negative far from the estimate, and the chain would run to ever smaller noise.
    """
    means = averaged(data.only(data.train), calibrated.noise(data).only(data.train))
    problem = LeastSquares.of(calibrated.model, *means).reweighted(calibrated.estimate, calibrated.loss)
    laplace = Laplace.of(problem, calibrated.estimate)
    squares = None
    if calibrated.errors.functions:
        laplace = laplace.beside_smooth_errors(calibrated.covariance)
        squares = laplace.squares(problem)
    return LogPosterior.about(problem, laplace, squares), laplace
