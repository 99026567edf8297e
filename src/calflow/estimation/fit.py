"""The fit: maximum a posteriori within bounds, one CasADi graph, solved by IPOPT with a Gauss-Newton Hessian.

Reweighted, its weights agree with what it leaves. What the markers of one standstill err in common is counted once: the size of
this intraclass correlation is the mean over all that its restricted likelihood allows (Patterson and Thompson 1971).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from calflow.estimation.accuracy import observing
from calflow.estimation.lack_of_fit import Evidence, LackOfFit, lack_of_fit
from calflow.estimation.least_squares import LeastSquares, Loss, Stacking, rho, rho_slope
from calflow.estimation.noise import LEAST_SCATTER, Noise, averaged, representative
from calflow.measurements.measurements import Measurements
from calflow.model import Model

AT_BOUND = 0.05  # posterior standard deviations from a bound: closer than that, IPOPT's barrier stopped it
# IPOPT forgives ten round-offs of the objective. Residuals are differences of metres that count in micrometres, whose round-off
# is larger: with this added to the scaled objective, IPOPT forgives it too, and does not search lines for what cannot be seen.
ROUND_OFF = 1e4
TOLERANCE = 1e-6  # IPOPT's, of the scaled objective
# Starts are near the optimum and seldom near a bound: the barrier begins as low as the tolerance lets it end, with multipliers
# that belong to it, which halves the iterations.
BARRIER = TOLERANCE / 10
# In half chi²: a further step that gains less moves no parameter by more than 0.0002 standard deviations.
SETTLED = 1e-8
# IPOPT's status where that was so, and what it is to the user.
STOPPED, SOLVED = "User_Requested_Stop", "Solve_Succeeded"
INTERRUPTED = "NonIpopt_Exception_Thrown"  # IPOPT's status where CasADi saw Ctrl-C, which it keeps to itself
SAME_OPTIMUM = 1e-2  # difference in the objective (half chi²) below which two starts found the same


@dataclass(frozen=True)
class Fit:
    """An estimate (n_parameters,) and what it is worth.

    residual (n,) is whitened by the problem's noise, information (n_parameters, n_parameters) the Gauss-Newton Hessian of the
    objective, priors included, to which rows far off give less by the loss. covariance is Laplace's, over the parameters off
    their bounds; a parameter at a bound has zeros there. objective is half of chi² plus half of the priors' part.
    """

    problem: LeastSquares
    estimate: np.ndarray
    objective: float
    residual: np.ndarray
    information: np.ndarray
    iterations: int
    converged: bool
    status: str
    loss: Loss = "linear"

    @property
    def model(self) -> Model:
        """The model."""
        return self.problem.model

    @property
    def stacking(self) -> Stacking:
        """What each of the residuals is."""
        return self.problem.stacking

    @cached_property
    def r_factor(self) -> np.ndarray:
        """Householder's R factor of the Jacobian, (n_parameters, n_parameters): it tells small directions that squares lose."""
        return self.problem.reweighted(self.estimate, self.loss).reduced(self.estimate)[1]

    @cached_property
    def at_bound(self) -> np.ndarray:
        """Which parameters sit on a bound, shape (n_parameters,)."""
        lower, upper = self.model.bounds.T
        margin = AT_BOUND * np.sqrt(np.diag(self._inverse(np.full(len(self.estimate), True))))
        return (self.estimate < lower + margin) | (self.estimate > upper - margin)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Laplace covariance, shape (n_parameters, n_parameters)."""
        return self._inverse(~self.at_bound)

    @cached_property
    def effective_parameters(self) -> float:
        """How many parameters the data determine: the sum over parameters of 1 - prior share."""
        return float(np.trace(self.covariance @ (self.information - np.diag(self.model.prior_sd**-2.0))))

    @property
    def reduced_chi2(self) -> float:
        """Chi² per degree of freedom; 1 where the noise explains all that is left."""
        return float((self.residual**2).sum() / max(1.0, self.residual.size - self.effective_parameters))

    def _inverse(self, free: np.ndarray) -> np.ndarray:
        """Inverse of the information of the free parameters, zero elsewhere; scaled by the priors to stay well-posed."""
        sd = self.model.prior_sd[free]
        scaled = self.information[np.ix_(free, free)] * np.outer(sd, sd)
        inverse = np.zeros((len(free), len(free)))
        inverse[np.ix_(free, free)] = np.linalg.inv(scaled) * np.outer(sd, sd)
        return inverse


def fit(problem: LeastSquares, starts: np.ndarray | None = None, loss: Loss = "linear") -> tuple[Fit, int]:
    """Return the best maximum-a-posteriori estimate over the starts, and how many starts agree with it.

    Args:
        problem: the model and its data.
        starts: parameter values to start from, shape (n_starts, n_parameters); the priors' means by default.
        loss: how the square of a row's whitened residual counts; soft_l1 and cauchy weigh outliers less.
    """
    solver, expanded, _callbacks = _solver(problem, loss)
    model = problem.model
    starts = model.prior_mean[None] if starts is None else starts
    lower, upper = model.bounds.T / model.prior_sd
    solutions = []
    for start in starts:
        inside = np.clip(start / model.prior_sd, lower + 1e-3 * (upper - lower), upper - 1e-3 * (upper - lower))
        solution = solver(x0=inside, lbx=lower, ubx=upper)
        if solver.stats()["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        at = np.array(solution["x"]).ravel()
        solutions.append((expanded(at.tobytes()), at, solver.stats()))
    there, x, stats = min(solutions, key=lambda solution: solution[0].value)
    agree = sum(other.value - there.value < SAME_OPTIMUM for other, _, _ in solutions)
    result = Fit(
        problem,
        x * model.prior_sd,
        there.value,
        there.residual,
        there.information(model.prior_sd),
        stats["iter_count"],
        stats["success"] or stats["return_status"] == STOPPED,
        SOLVED if stats["return_status"] == STOPPED else stats["return_status"],
        loss,
    )
    return result, agree


def restated(result: Fit, problem: LeastSquares) -> Fit:
    """Return a fit's residuals and information by the weights of a problem, at the same estimate."""
    prior_sd = problem.model.prior_sd
    there = expansion(problem, result.estimate / prior_sd, result.loss)
    return replace(result, problem=problem, residual=there.residual, information=there.information(prior_sd))


def draw_starts(model: Model, n_starts: int, rng: np.random.Generator) -> np.ndarray:
    """Return the priors' means and n_starts - 1 draws from half the prior's width, shape (n_starts, n_parameters)."""
    drawn = model.prior_mean + 0.5 * model.prior_sd * rng.standard_normal((n_starts - 1, len(model.prior_mean)))
    return np.vstack([model.prior_mean, np.clip(drawn, *model.bounds.T)])


@dataclass(frozen=True)
class Expansion:
    """The objective at one point, its gradient and Gauss-Newton Hessian, in coordinates scaled by the priors.

    residual (n,) are the stacked whitened residuals, independent (n,) the same without what rows of a standstill share.
    """

    value: float
    gradient: np.ndarray
    hessian: np.ndarray
    residual: np.ndarray
    independent: np.ndarray

    def information(self, prior_sd: np.ndarray) -> np.ndarray:
        """Return the Hessian in the parameters' own units."""
        return np.asarray(self.hessian / np.outer(prior_sd, prior_sd))


def expansion(problem: LeastSquares, x: np.ndarray, loss: Loss) -> Expansion:
    """Expand the objective about scaled parameters x, block by block of rows, so that memory does not grow with them."""
    model, n = problem.model, len(x)
    offset = x - model.prior_mean / model.prior_sd
    value, gradient, hessian = 0.5 * offset @ offset, offset.copy(), np.eye(n)
    errors, residuals = list[np.ndarray](), list[np.ndarray]()
    for block in problem.blocks:
        for _, error, residual, jacobian in block.independent(x * model.prior_sd):
            squared = (residual**2).sum(axis=1)
            slope = rho_slope(squared, loss)[:, None, None]
            scaled = (jacobian * model.prior_sd).reshape(-1, n)
            weighted = scaled if loss == "linear" else (slope * jacobian * model.prior_sd).reshape(-1, n)
            value += 0.5 * float(rho(squared, loss).sum())
            gradient += weighted.T @ residual.ravel()
            hessian += weighted.T @ scaled
            errors.append(error.ravel())
            residuals.append(residual.ravel())
    return Expansion(value, gradient, hessian, np.concatenate(errors), np.concatenate(residuals))


Answer = Callable[..., Sequence[Any]]


class _Asked(ca.Callback):
    """One of the functions that IPOPT asks for, of dense inputs in NumPy's own memory: each output's entries, by its name."""

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


def _solver(problem: LeastSquares, loss: Loss) -> tuple[ca.Function, Callable[[bytes], Expansion], list[_Asked]]:
    """Build IPOPT's solver in coordinates scaled by the priors, and what it expands the objective by.

    The callbacks must live as long as the solver does.
    """
    n, bounds = len(problem.model.parameters), problem.model.bounds.T / problem.model.prior_sd
    scale, size = problem.scale, problem.size

    @lru_cache(maxsize=2)
    def at(point: bytes) -> Expansion:
        return expansion(problem, np.frombuffer(point), loss)

    def settled(
        x: np.ndarray, f: np.ndarray, g: np.ndarray, multipliers: np.ndarray, *others: np.ndarray
    ) -> list[bool]:
        there, pushed = at(x.tobytes()), scale * multipliers
        left = there.gradient + pushed
        room = np.where(pushed < 0, x - bounds[0], bounds[1] - x)
        gain = 0.5 * left @ np.linalg.solve(there.hessian, left)  # at least what a further step would gain
        misfit = max(1.0, there.value / size)
        return [bool(gain < SETTLED * misfit and (np.abs(pushed) * room).max() < SAME_OPTIMUM)]

    def value(x: np.ndarray) -> float:
        return at(x.tobytes()).value / scale + ROUND_OFF

    point, scalar, upper = {"x": n, "p": 0}, ca.Sparsity.dense(1, 1), np.tril_indices(n)
    nlp = _Asked("nlp", point, {"f": scalar, "g": ca.Sparsity(0, 1)}, lambda x, p: (value(x), ()))
    gradient = _Asked(
        "grad_f", point, {"f": scalar, "grad_f_x": ca.Sparsity.dense(n, 1)},
        lambda x, p: (value(x), at(x.tobytes()).gradient / scale),
    )  # fmt: skip
    hessian = _Asked(
        "hess_lag", {**point, "lam_f": 1, "lam_g": 0}, {"triu_hess_gamma_x_x": ca.Sparsity.upper(n)},
        lambda x, p, factor, multipliers: [factor / scale * at(x.tobytes()).hessian[upper]],
    )  # fmt: skip
    stop = _Asked("stop", {"x": n, "f": 1, "g": 0, "lam_x": n, "lam_g": 0, "lam_p": 0}, {"stop": scalar}, settled)
    options: dict[str, Any] = {
        "grad_f": gradient,
        "hess_lag": hessian,
        "no_nlp_grad": True,
        "print_time": False,
        "iteration_callback": stop,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": 200, "nlp_scaling_method": "none",
                  "mu_init": min(BARRIER, 0.1 * SAME_OPTIMUM / scale),
                  "bound_mult_init_method": "mu-based", "bound_relax_factor": 0.0},
    }  # fmt: skip
    return ca.nlpsol("fit", "ipopt", nlp, options), at, [nlp, gradient, hessian, stop]


START_ROWS = 2000  # rows on which several starts are compared; all rows are fitted from the best
NOISE_PASSES = 4  # fits in which an estimated noise settles


def fit_reweighted(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss, tolerance: float = 0.01
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit the means of repeats, and refit until the weights agree with what the fit leaves.

    A noise that is not known is estimated, series by series; to one that is known the model's own discrepancy is added where
    it shows. Returned are the fit, its noise, the lack of fit against the noise alone, and how many of the starts agree.
    """
    model = observing(model, train)
    train, noise = averaged(train, noise)
    some = representative(train, START_ROWS if len(starts) > 1 else len(train))
    result, agree = fit(LeastSquares.of(model, train.only(some), noise.only(some)), starts, loss)
    problem = LeastSquares.of(model, train, noise)
    if not some.all():
        result, _ = fit(problem, result.estimate[None], loss)
    evidence = Evidence.of(train, noise)
    against_noise = _of_leading(result, problem, noise, evidence, loss)
    for _ in range(NOISE_PASSES):
        before, noise = noise, _agreeing(result, problem, noise, evidence, loss)
        problem = LeastSquares.of(model, train, noise)
        if _alike(noise, before, tolerance):
            result = restated(result, problem)
            break
        result, _ = fit(problem, result.estimate[None], loss)
    return result, noise, against_noise, agree


def _agreeing(result: Fit, problem: LeastSquares, noise: Noise, evidence: Evidence, loss: Loss) -> Noise:
    """The noise that agrees with what the fit leaves."""
    stacking = problem.stacking
    estimated = noise.estimated
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        rows = noise.of_series(k)
        if source == "estimated" and rows.any():
            lack = _lack(result, problem, stacking.of_row(rows) & stacking.leading, evidence, loss)
            sigma[rows] = np.maximum(sigma[rows] * np.sqrt(lack.reduced_chi2), (LEAST_SCATTER * noise.usual)[rows])
    discrepancy = noise.discrepancy
    for unit in problem.units:
        stated = stacking.in_unit(unit) & (stacking.of_row(~estimated) | ~stacking.leading)
        if stated.any():
            here = evidence.only_where(noise.in_unit(unit))  # repeats tell the noise of the leading unit alone
            discrepancy = discrepancy.having(unit, _lack(result, problem, stated, here, loss).discrepancy)
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


def _of_leading(result: Fit, problem: LeastSquares, noise: Noise, evidence: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of residuals in their series' leading units whose noise is known, of all such where none is."""
    stacking = problem.stacking
    stated = stacking.of_row(~noise.estimated) & stacking.leading
    return _lack(result, problem, stated if stated.any() else stacking.leading, evidence, loss)


def _lack(result: Fit, problem: LeastSquares, which: np.ndarray, evidence: Evidence, loss: Loss) -> LackOfFit:
    """Lack of fit of some of the residuals, which bear their share of the parameters."""
    error = (result.residual * problem.total)[which]
    determined = result.effective_parameters * np.count_nonzero(which) / len(which)
    return lack_of_fit(error, problem.sigma[which], determined, problem.stacking.row[which], evidence, loss != "linear")


def _alike(first: Noise, other: Noise, tolerance: float) -> bool:
    pairs = [(first.total, other.total)]
    for (unit, sigma), (_, before) in zip(first.further, other.further, strict=True):
        pairs.append((np.hypot(sigma, first.discrepancy[unit]), np.hypot(before, other.discrepancy[unit])))
    return all(np.allclose(a, b, rtol=tolerance, equal_nan=True) for a, b in pairs)


def fit_sharing(
    model: Model, train: Measurements, noise: Noise, starts: np.ndarray, loss: Loss
) -> tuple[Fit, Noise, LackOfFit, int]:
    """Fit as `fit_reweighted` does, what the markers of a standstill err in common counted once.

    Rows of which each is the only one at its standstill are fitted as there.
    """
    means, _ = averaged(train, noise)
    result, noise, lack, agree = fit_reweighted(model, train, noise, starts, loss)
    if (together := SquaresTogether.of(result, means, noise)) and (correlation := together.correlation):
        noise = _sized(replace(noise, intraclass=correlation), together.level(correlation))
        result, _ = fit(LeastSquares.of(result.model, means, noise), result.estimate[None], loss)
    return result, noise, lack, agree


def fit_to_all(result: Fit, part: Noise, settled: Noise, means: Measurements, noise: Noise) -> tuple[Fit, Noise]:
    """Return a fit to all rows from one to those that are `representative`, and the noise of all.

    Args:
        result: the fit to the part.
        part: the noise of the part before that fit.
        settled: the same after it.
        means: all rows, means of repeats.
        noise: that of all before any fit.
    """
    sigma, grown = noise.sigma.copy(), settled.sigma / part.sigma
    for k in range(len(noise.sources)):
        if (rows := noise.of_series(k)).any():
            sigma[rows] *= np.median(grown[part.of_series(k)])
    every = replace(noise, sigma=sigma, discrepancy=settled.discrepancy, intraclass=settled.intraclass)
    return fit(LeastSquares.of(result.model, means, every), result.estimate[None], result.loss)[0], every


def _sized(noise: Noise, level: float) -> Noise:
    """Return a noise whose variance about the model is so many times as large: what of it is not known from elsewhere."""
    sigma = np.where(
        noise.estimated, np.maximum(noise.sigma * np.sqrt(level), LEAST_SCATTER * noise.usual), noise.sigma
    )
    discrepancy = noise.discrepancy
    for unit in dict.fromkeys(noise.leading):
        if size := discrepancy[unit]:
            stated = float(np.mean(noise.sigma[~noise.estimated & noise.in_unit(unit)] ** 2))
            discrepancy = discrepancy.having(unit, float(np.sqrt(max(level * (stated + size**2) - stated, 0.0))))
    return replace(noise, sigma=sigma, discrepancy=discrepancy)


CORRELATIONS = np.linspace(0.0, 0.98, 50)  # beyond, what markers have apart would be less than any device's noise
# Before the data there is none as likely as any, and that is as likely to be of one size as of another (Daniels 1999).
LIKELY = np.where(CORRELATIONS == 0, 0.5, 0.5 / (len(CORRELATIONS) - 1))


# What images tell of their points' common errors beyond what the parameters take of it. With less, whatever else is wrong within
# images, as of a bent board, would pass for such errors.
ENOUGH_COMMON = 10.0


@dataclass(frozen=True, eq=False)
class SquaresTogether:
    """What a fit's rows tell of the correlation of what markers of a standstill err, by its restricted likelihood.

    each (p + 1, p + 1) are products of the whitened Jacobian by free parameters, over their priors, and residuals, side by side;
    summed (n_sizes, p + 1, p + 1) the same of sums over standstills of as many markers (n_sizes,), of which there are number
    (n_sizes,); prior (p + 1, p + 1) are those of the priors. freedom are the degrees of freedom that the parameters leave.
    """

    each: np.ndarray
    summed: np.ndarray
    prior: np.ndarray
    markers: np.ndarray
    number: np.ndarray
    freedom: float

    @staticmethod
    def of(result: Fit, data: Measurements, noise: Noise) -> SquaresTogether | None:
        """Add them up at a fit's estimate; none where no rows share errors, or a robust loss weighs each row for itself."""
        problem = LeastSquares.of(result.model, data, noise)
        alike = [block for block in problem.blocks if block.sharing.size.max() > 1]
        images = sum(len(block.sharing.begins) * block.n_units for block in alike if block.observation.series.within)
        if result.loss != "linear" or not alike or 0 < images < result.effective_parameters + ENOUGH_COMMON:
            return None
        free, sd = np.flatnonzero(~result.at_bound), result.model.prior_sd
        # Of what the priors hold back: their pull would tell of the noise how large parameters are.
        prior = np.diag(np.append(np.ones(len(free)), 0.0))
        sums, numbers = dict[int, np.ndarray](), Counter[int]()
        each = np.zeros_like(prior)
        for block in problem.blocks:
            parts = zip(block.parts(), block.linearised(result.estimate), strict=True)
            for part, (_, residual, jacobian) in parts:
                both = np.concatenate([(jacobian * sd)[..., free], residual[:, :, None]], axis=2)
                each += np.tensordot(both, both, ((0, 1), (0, 1)))
                sharing = block.sharing.only(part)
                together = np.add.reduceat(both, sharing.begins)
                for size in map(int, np.unique(sharing.size)):
                    of_size = together[sharing.size == size]
                    sums[size] = sums.get(size, 0.0) + np.tensordot(of_size, of_size, ((0, 1), (0, 1)))
                    numbers[size] += of_size.shape[0] * of_size.shape[1]
        markers, number = (np.array([*values]) for values in (sums, (numbers[size] for size in sums)))
        freedom = max(1.0, result.residual.size - result.effective_parameters)
        return SquaresTogether(each, np.array([*sums.values()]), prior, markers, number, freedom)

    @property
    def correlation(self) -> float:
        """The mean share of the errors' variance that is in common, over all that the data allow."""
        weight = LIKELY * np.exp((self._costs.min() - self._costs) / 2)
        return float(weight @ CORRELATIONS / weight.sum())

    @property
    def gain(self) -> float:
        """Twice the logarithm of the likelihood that the likeliest correlation adds."""
        return float(self._costs[0] - self._costs.min())

    def level(self, correlation: float) -> float:
        """Return the variance of what is left beside a correlation, over what it was taken for."""
        return float(self._factor(correlation)[-1, -1] ** 2 / self.freedom)

    @cached_property
    def _costs(self) -> np.ndarray:
        """Twice minus the logarithm of the restricted likelihood of CORRELATIONS, the noise's level at its best."""
        return np.array([self._cost(correlation) for correlation in CORRELATIONS])

    def _cost(self, r: float) -> float:
        diagonal, others = np.log(self._factor(r).diagonal()), self.markers - 1
        spread = self.number @ (others * np.log1p(-r) + np.log1p(others * r))
        return float(2 * (self.freedom * diagonal[-1] + diagonal[:-1].sum()) + spread)

    def _factor(self, r: float) -> np.ndarray:
        """The lower triangular factor (p + 1, p + 1) of the products without what is shared; its last number squared is left."""
        shared = np.tensordot(r / (1 + (self.markers - 1) * r), self.summed, 1)
        return np.linalg.cholesky((self.each - shared) / (1 - r) + self.prior)
