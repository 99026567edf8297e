"""The fit: maximum a posteriori within bounds, one CasADi graph, solved by IPOPT with a Gauss-Newton Hessian.

Unknown noise and the model's discrepancy are re-estimated from the residuals until the weights settle. Markers of one standstill
share errors by an intraclass correlation, the mean over its restricted likelihood (Patterson and Thompson 1971).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from calflow.estimation.accuracy import observing
from calflow.estimation.lack_of_fit import Evidence, LackOfFit, lack_of_fit
from calflow.estimation.least_squares import LeastSquares, Loss, rho, rho_slope
from calflow.estimation.noise import LEAST_SCATTER, Noise, averaged, representative
from calflow.estimation.variance_components import NormalEquations
from calflow.files.units import RADIAN
from calflow.measurements.measurements import Measurements
from calflow.model import Model

AT_BOUND = 0.05  # posterior standard deviations: an estimate closer to a bound was stopped by IPOPT's barrier
TOLERANCE = 1e-6  # IPOPT's, of the scaled objective
# Starts are near the optimum and seldom near a bound: the barrier parameter starts at the lowest value the tolerance lets it reach,
# with multipliers to match, which halves the iterations.
BARRIER = TOLERANCE / 10
# Decrease of half chi²: a further step that gains less moves no parameter by more than 0.0002 standard deviations.
SETTLED = 1e-8
# IPOPT's status after that stop, and the status that the user sees.
STOPPED, SOLVED = "User_Requested_Stop", "Solve_Succeeded"
INTERRUPTED = "NonIpopt_Exception_Thrown"  # IPOPT's status after Ctrl-C, which CasADi catches without raising
INSIDE = 1e-3  # of the range between its bounds, by which a parameter that starts on one is moved inside
SAME_OPTIMUM = 1e-2  # difference in the objective (half chi²) below which two starts reached the same optimum
START_ROWS = 2000  # rows on which several starts are compared; the fit to all rows begins at the best
NOISE_PASSES = 4  # refits at most, in which the estimated noise settles
CORRELATIONS = np.linspace(0.0, 0.98, 50)  # beyond, the markers' independent errors would be below any device's noise
# Prior: no correlation is as probable as any, and a correlation is uniform in its size (Daniels 1999).
LIKELY = np.where(CORRELATIONS == 0, 0.5, 0.5 / (len(CORRELATIONS) - 1))
# Degrees of freedom of the images' common errors beyond those that the parameters absorb. With fewer, other errors within images,
# as of a bent board, would pass for common errors.
MIN_COMMON_FREEDOM = 10.0


@dataclass(frozen=True)
class Fit:
    """The maximum-a-posteriori estimate (n_parameters,), with its residuals and information matrix.

    objective is half of chi² plus half of the priors' quadratic form. residual (n,) is whitened by the problem's noise, before
    decorrelation within standstills. gradient (n_parameters,) and information (n_parameters, n_parameters) are the objective's
    derivative and Gauss-Newton Hessian, priors included, with rows weighted by the loss. covariance is Laplace's, over the
    parameters off their bounds, with zeros for a parameter at a bound. iterations, converged and status are the solver's.
    """

    problem: LeastSquares
    estimate: np.ndarray
    loss: Loss
    objective: float
    residual: np.ndarray
    gradient: np.ndarray
    information: np.ndarray
    iterations: int = 0
    converged: bool = True
    status: str = ""

    @staticmethod
    def at(problem: LeastSquares, estimate: np.ndarray, loss: Loss = "linear") -> Fit:
        """Return the objective and its derivatives at an estimate, block by block, so that memory does not grow with the rows."""
        model, n = problem.model, len(estimate)
        offset, precision = estimate - model.prior_mean, model.prior_sd**-2.0
        value, gradient, information = 0.5 * offset @ (precision * offset), precision * offset, np.diag(precision)
        errors = list[np.ndarray]()
        for part in problem.parts():
            error, slopes = part.linearised(estimate)
            residual, jacobian = part.decorrelated(error), part.decorrelated(slopes)
            squared = (residual**2).sum(axis=1)
            weighted = jacobian if loss == "linear" else rho_slope(squared, loss)[:, None, None] * jacobian
            value += 0.5 * float(rho(squared, loss).sum())
            gradient += weighted.reshape(-1, n).T @ residual.ravel()
            information += weighted.reshape(-1, n).T @ jacobian.reshape(-1, n)
            errors.append(error.ravel())
        return Fit(problem, estimate, loss, float(value), np.concatenate(errors), gradient, information)

    @property
    def model(self) -> Model:
        return self.problem.model

    @cached_property
    def at_bound(self) -> np.ndarray:
        """Which parameters sit on a bound, shape (n_parameters,)."""
        lower, upper = self.model.bounds.T
        margin = AT_BOUND * np.sqrt(np.diag(self._inverse(np.full(len(self.estimate), True))))
        return (self.estimate < lower + margin) | (self.estimate > upper - margin)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Laplace covariance of the estimate, shape (n_parameters, n_parameters)."""
        return self._inverse(~self.at_bound)

    @cached_property
    def effective_parameters(self) -> float:
        """Effective number of parameters that the data determine: the sum over parameters of 1 - prior share."""
        return float(np.vdot(self.covariance, self.information - np.diag(self.model.prior_sd**-2.0)))

    def from_zero(self, columns: np.ndarray, covariance: np.ndarray) -> float:
        """Return the squared distance from zero (Wald 1943) of those of some parameters that are off bounds; covariance: of all."""
        free = columns[~self.at_bound[columns]]
        return float(self.estimate[free] @ np.linalg.solve(covariance[np.ix_(free, free)], self.estimate[free]))

    def _inverse(self, free: np.ndarray) -> np.ndarray:
        """Inverse of the free parameters' information, zero elsewhere; scaled by the priors to stay well-conditioned."""
        sd = self.model.prior_sd[free]
        scaled = self.information[np.ix_(free, free)] * np.outer(sd, sd)
        inverse = np.zeros((len(free), len(free)))
        inverse[np.ix_(free, free)] = np.linalg.inv(scaled) * np.outer(sd, sd)
        return inverse


def fit(
    problem: LeastSquares, starts: np.ndarray | None = None, loss: Loss = "linear", rough: float = 0.0
) -> tuple[Fit, int]:
    """Return the best maximum-a-posteriori estimate over the starts, and the number of starts that reached it.

    Args:
        problem: the model and its data.
        starts: parameter values to start from, shape (n_starts, n_parameters); the priors' means by default.
        loss: soft_l1 and cauchy down-weight outliers.
        rough: share of the objective that a further step may still gain.
    """
    solver, at, _callbacks = _solver(problem, loss, rough)
    model = problem.model
    starts = model.prior_mean[None] if starts is None else starts
    lower, upper = model.bounds.T / model.prior_sd
    room = INSIDE * (upper - lower)
    solutions = []
    for start in starts / model.prior_sd:
        # What an earlier fit left just inside a bound stays there: from further off, the first step would stop at the bound.
        stopped = (start <= lower) | (start >= upper)
        inside = np.where(stopped, np.clip(start, lower + room, upper - room), start)
        solution = solver(x0=inside, lbx=lower, ubx=upper)
        if solver.stats()["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        solutions.append((at(np.array(solution["x"]).tobytes()), solver.stats()))
    there, stats = min(solutions, key=lambda solution: solution[0].objective)
    agree = sum(other.objective - there.objective < SAME_OPTIMUM for other, _ in solutions)
    stopped = stats["return_status"] == STOPPED
    result = replace(
        there,
        iterations=stats["iter_count"],
        converged=stats["success"] or stopped,
        status=SOLVED if stopped else stats["return_status"],
    )
    return result, agree


def draw_starts(model: Model, n_starts: int, rng: np.random.Generator) -> np.ndarray:
    """Return the priors' means and n_starts - 1 draws with half the priors' standard deviation, (n_starts, n_parameters).

    What an observation places (a camera with its lens, a board) starts where it was registered: half a metre off, a board may
    be behind its camera, from where no fit finds back.
    """
    drawn = model.prior_mean + 0.5 * model.prior_sd * rng.standard_normal((n_starts - 1, len(model.prior_mean)))
    for observation in model.observations:
        columns = model.columns(observation)
        drawn[:, columns] = model.prior_mean[columns]
    return np.vstack([model.prior_mean, np.clip(drawn, *model.bounds.T)])


Answer = Callable[..., Sequence[Any]]


class _Callback(ca.Callback):
    """A function that IPOPT evaluates, written in NumPy: named dense inputs to the nonzeros of named outputs."""

    def __init__(self, name: str, inputs: dict[str, int], outputs: dict[str, ca.Sparsity], answer: Answer) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._answer = inputs, outputs, answer
        self.construct(name, {"enable_fd": False})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return list(self._inputs)[i]

    def get_name_out(self, i: int) -> str:
        return list(self._outputs)[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(list(self._inputs.values())[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return list(self._outputs.values())[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        answers = self._answer(*(np.frombuffer(values or b"") for values in arg))
        for place, value in zip(res, answers, strict=True):
            if place:
                np.frombuffer(place)[:] = value
        return 0


def _solver(
    problem: LeastSquares, loss: Loss, rough: float
) -> tuple[ca.Function, Callable[[bytes], Fit], list[_Callback]]:
    """Return IPOPT's solver in units of the priors, the cached evaluation at a point, and its callbacks, which must live on."""
    n, sd = len(problem.model.parameters), problem.model.prior_sd
    bounds, scale, size = problem.model.bounds.T / sd, problem.n_rows, problem.size

    @lru_cache(maxsize=2)
    def at(point: bytes) -> Fit:
        return Fit.at(problem, np.frombuffer(point) * sd, loss)

    def settled(
        x: np.ndarray, f: np.ndarray, g: np.ndarray, multipliers: np.ndarray, *others: np.ndarray
    ) -> list[bool]:
        there, pushed = at(x.tobytes()), scale * multipliers
        left = there.gradient * sd + pushed
        room = np.where(pushed < 0, x - bounds[0], bounds[1] - x)
        # The decrease that a Newton step predicts.
        gain = 0.5 * left @ np.linalg.solve(there.information * np.outer(sd, sd), left)
        enough = max(SETTLED * max(1.0, there.objective / size), rough * there.objective)
        return [bool(gain < enough and (np.abs(pushed) * room).max() < SAME_OPTIMUM)]

    def value(x: np.ndarray) -> float:
        return at(x.tobytes()).objective / scale

    point, scalar, upper = {"x": n, "p": 0}, ca.Sparsity.dense(1, 1), np.tril_indices(n)
    nlp = _Callback("nlp", point, {"f": scalar, "g": ca.Sparsity(0, 1)}, lambda x, p: (value(x), ()))
    gradient = _Callback(
        "grad_f", point, {"f": scalar, "grad_f_x": ca.Sparsity.dense(n, 1)},
        lambda x, p: (value(x), at(x.tobytes()).gradient * sd / scale),
    )  # fmt: skip
    hessian = _Callback(
        "hess_lag", {**point, "lam_f": 1, "lam_g": 0}, {"triu_hess_gamma_x_x": ca.Sparsity.upper(n)},
        lambda x, p, factor, multipliers: [factor / scale * (at(x.tobytes()).information * np.outer(sd, sd))[upper]],
    )  # fmt: skip
    stop = _Callback("stop", {"x": n, "f": 1, "g": 0, "lam_x": n, "lam_g": 0, "lam_p": 0}, {"stop": scalar}, settled)
    options: dict[str, Any] = {
        "grad_f": gradient,
        "hess_lag": hessian,
        "no_nlp_grad": True,
        "print_time": False,
        "iteration_callback": stop,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": 200, "nlp_scaling_method": "none",
                  "mu_init": min(BARRIER, 0.1 * SAME_OPTIMUM / scale),
                  "bound_mult_init_method": "mu-based", "bound_relax_factor": 0.0,
                  "bound_push": 1e-12, "bound_frac": 1e-12},
    }  # fmt: skip
    return ca.nlpsol("fit", "ipopt", nlp, options), at, [nlp, gradient, hessian, stop]


def fit_reweighted(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss, tolerance: float = 0.01
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit the means of repeats, and refit until the weights agree with the residuals.

    An unknown noise is estimated series by series; to a known noise the model's discrepancy is added where it is significant.
    Returns the fit, its noise, the lack of fit against the noise alone (of the residuals in leading units whose noise is known, if
    there are any), and the number of starts that reached the optimum.
    """
    model = observing(model, train)
    train, noise = averaged(train, noise)
    some = representative(train, START_ROWS if len(starts) > 1 else len(train))
    result, agree = fit(LeastSquares.of(model, train.only(some), noise.only(some)), starts, loss)
    if not some.all():
        result, _ = fit(LeastSquares.of(model, train, noise), result.estimate[None], loss)
    evidence = Evidence.of(train, noise)
    against_noise = lack_against_noise(result, noise, evidence)
    for _ in range(NOISE_PASSES):
        before, noise = noise, reestimated(result, noise, evidence)
        problem = LeastSquares.of(model, train, noise)
        if alike(noise, before, tolerance):
            there = Fit.at(problem, result.estimate, loss)
            result = replace(there, iterations=result.iterations, converged=result.converged, status=result.status)
            break
        result, _ = fit(problem, result.estimate[None], loss)
    return result, noise, against_noise, agree


def lack_against_noise(result: Fit, noise: Noise, evidence: Evidence) -> LackOfFit:
    """Return the lack of fit of the residuals in leading units whose noise is known, if there are any, else of all of them."""
    leading = result.problem.leading
    known = ~noise.estimated[result.problem.row] & leading
    return _lack(result, known if known.any() else leading, evidence)


def reestimated(result: Fit, noise: Noise, evidence: Evidence) -> Noise:
    """Return the noise re-estimated from the fit's residuals: sigma where it is unknown, the discrepancy elsewhere."""
    problem, sigma = result.problem, noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        rows = noise.of_series(k)
        if source == "estimated" and rows.any():
            lack = _lack(result, rows[problem.row] & problem.leading, evidence)
            sigma[rows] = np.maximum(sigma[rows] * np.sqrt(lack.reduced_chi2), (LEAST_SCATTER * noise.usual)[rows])
    discrepancy = noise.discrepancy
    for unit in dict.fromkeys(unit for block in problem.blocks for unit in block.observation.units):
        stated = problem.in_unit(unit) & (~noise.estimated[problem.row] | ~problem.leading)
        if stated.any():
            # Repeats determine the noise of the leading unit alone.
            here = evidence.only_where(noise.in_unit(unit))
            discrepancy = discrepancy.having(unit, _lack(result, stated, here).discrepancy)
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


def _lack(result: Fit, which: np.ndarray, evidence: Evidence) -> LackOfFit:
    """Return the lack of fit of a subset of the residuals, charged with its share of the effective parameters."""
    error = (result.residual * result.problem.total)[which]
    sigma, rows = result.problem.sigma[which], result.problem.row[which]
    determined = result.effective_parameters * np.count_nonzero(which) / len(which)
    return lack_of_fit(error, sigma, determined, rows, evidence, trimmed=result.loss != "linear")


def alike(first: Noise, other: Noise, tolerance: float) -> bool:
    """Whether two noises of the same rows, with the model's discrepancy, differ by no more than a relative tolerance."""
    pairs = [(first.total, other.total)]
    if first.rotation is not None:
        now, before = (np.hypot(first.rotation, noise.discrepancy[RADIAN]) for noise in (first, other))
        pairs.append((now, before))
    return all(np.allclose(a, b, rtol=tolerance, equal_nan=True) for a, b in pairs)


def fit_sharing(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit as `fit_reweighted` does, and where standstills have several rows, once more with correlated errors within them."""
    means, _ = averaged(train, noise)
    result, noise, lack, agree = fit_reweighted(model, train, noise, starts, loss)
    return *refitted_sharing(result, means, noise), lack, agree


def refitted_sharing(
    result: Fit, means: Measurements, noise: Noise, correlation: float | None = None
) -> tuple[Fit, Noise]:
    """Return a fit to means of repeats with errors that rows of a standstill share, and its noise; correlation: else estimated."""
    likelihood = IntraclassLikelihood.of(result, means, noise)
    correlation = likelihood.correlation if likelihood and correlation is None else correlation
    if not (likelihood and correlation):
        return result, noise
    noise = _sized(replace(noise, intraclass=correlation), likelihood.level(correlation))
    return fit(LeastSquares.of(result.model, means, noise), result.estimate[None], result.loss)[0], noise


def fit_to_all(result: Fit, part: Noise, settled: Noise, means: Measurements, noise: Noise) -> tuple[Fit, Noise]:
    """Return a fit to all rows, means of repeats, started from a fit to a `representative` subset, and the noise of all rows.

    part and settled are the subset's noise before and after that fit, noise is that of all rows before any.
    """
    sigma, grown = noise.sigma.copy(), settled.sigma / part.sigma
    for k in range(len(noise.sources)):
        if (rows := noise.of_series(k)).any():
            sigma[rows] *= np.median(grown[part.of_series(k)])
    every = replace(noise, sigma=sigma, discrepancy=settled.discrepancy, intraclass=settled.intraclass)
    return fit(LeastSquares.of(result.model, means, every), result.estimate[None], result.loss)[0], every


def _sized(noise: Noise, level: float) -> Noise:
    """Return the noise with its variance about the model scaled by level: unknown sigmas, and else the discrepancy, change."""
    sigma = np.where(
        noise.estimated, np.maximum(noise.sigma * np.sqrt(level), LEAST_SCATTER * noise.usual), noise.sigma
    )
    discrepancy = noise.discrepancy
    for unit in dict.fromkeys(noise.leading):
        if size := discrepancy[unit]:
            stated = float(np.mean(noise.sigma[~noise.estimated & noise.in_unit(unit)] ** 2))
            discrepancy = discrepancy.having(unit, float(np.sqrt(max(level * (stated + size**2) - stated, 0.0))))
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


@dataclass(frozen=True, eq=False)
class IntraclassLikelihood:
    """Restricted likelihood of the intraclass correlation of the errors of markers at one standstill.

    each (p + 1, p + 1) is MᵀM, where M holds the whitened Jacobian by the p free parameters, scaled by their priors, and the
    residual as its last column; summed (n_sizes, p + 1, p + 1) is the same of M's sums over standstills, by number of markers
    (n_sizes,), number (n_sizes,) being the count of such sums; prior (p + 1, p + 1) is the priors' precision in the same scale.
    freedom is the number of residuals less that of the effective parameters.
    """

    each: np.ndarray
    summed: np.ndarray
    prior: np.ndarray
    markers: np.ndarray
    number: np.ndarray
    freedom: float

    @staticmethod
    def of(result: Fit, data: Measurements, noise: Noise) -> IntraclassLikelihood | None:
        """Sum the products at a fit's estimate; None where no rows share errors, or the loss is robust and weighs rows singly."""
        problem = LeastSquares.of(result.model, data, noise)
        alike = [block for block in problem.blocks if block.size.max() > 1]
        images = sum(len(block.begins) * block.n_units for block in alike if block.observation.series.within)
        if result.loss != "linear" or not alike or 0 < images < result.effective_parameters + MIN_COMMON_FREEDOM:
            return None
        free, sd = np.flatnonzero(~result.at_bound), result.model.prior_sd
        # The priors' residuals are left out: they would let the parameters' sizes tell of the noise.
        prior = np.diag(np.append(np.ones(len(free)), 0.0))
        markers = np.unique(np.concatenate([block.size for block in problem.blocks]))
        each, summed, number = np.zeros(prior.shape), np.zeros((len(markers), *prior.shape)), np.zeros(len(markers))
        for part in problem.parts():
            residual, jacobian = part.linearised(result.estimate)
            both = np.concatenate([(jacobian * sd)[..., free], residual[:, :, None]], axis=2)
            each += np.tensordot(both, both, ((0, 1), (0, 1)))
            together, sizes = np.add.reduceat(both, part.begins), part.size
            for k, size in enumerate(markers):
                of_size = together[sizes == size]
                summed[k] += np.tensordot(of_size, of_size, ((0, 1), (0, 1)))
                number[k] += of_size.shape[0] * of_size.shape[1]
        freedom = max(1.0, result.residual.size - result.effective_parameters)
        return IntraclassLikelihood(each, summed, prior, markers, number, freedom)

    @property
    def correlation(self) -> float:
        """Posterior mean of the intraclass correlation, over the grid CORRELATIONS."""
        weight = LIKELY * np.exp((self._costs.min() - self._costs) / 2)
        return float(weight @ CORRELATIONS / weight.sum())

    @property
    def gain(self) -> float:
        """Twice the log-likelihood ratio of the likeliest correlation against none."""
        return float(self._costs[0] - self._costs.min())

    def level(self, correlation: float) -> float:
        """Return the estimated variance of the whitened errors, given their correlation (1: the noise was as assumed)."""
        return self._equations(correlation).restricted_likelihood(self.freedom)[0]

    @cached_property
    def _costs(self) -> np.ndarray:
        """Minus twice the restricted log-likelihood of each of CORRELATIONS, maximised over the noise's level."""
        return np.array([self._cost(correlation) for correlation in CORRELATIONS])

    def _cost(self, r: float) -> float:
        others = self.markers - 1
        log_determinant = float(self.number @ (others * np.log1p(-r) + np.log1p(others * r)))
        return self._equations(r).restricted_likelihood(self.freedom)[1] + log_determinant

    def _equations(self, r: float) -> NormalEquations:
        shared = np.tensordot(r / (1 + (self.markers - 1) * r), self.summed, 1)
        return NormalEquations((self.each - shared) / (1 - r) + self.prior, int(self.number @ self.markers))
