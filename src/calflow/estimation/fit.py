"""The fit: maximum a posteriori within bounds, one CasADi graph, solved by IPOPT with a Gauss-Newton Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from calflow.estimation.least_squares import LeastSquares, Loss, Stacking, rho, rho_slope
from calflow.model import Model

AT_BOUND = 0.05  # posterior standard deviations from a bound: closer than that, IPOPT's barrier stopped it
# IPOPT forgives ten round-offs of the objective. Residuals are differences of metres that count in micrometres, whose round-off
# is larger: with this added to the scaled objective, IPOPT forgives it too, and does not search lines for what cannot be seen.
ROUND_OFF = 1e4
TOLERANCE = 1e-6  # IPOPT's, of the scaled objective
# Starts are near the optimum and seldom near a bound: the barrier begins as low as the tolerance lets it end, with multipliers
# that belong to it, which halves the iterations.
BARRIER = TOLERANCE / 10
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
        found = solver(x0=inside, lbx=lower, ubx=upper)
        if solver.stats()["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        at = np.array(found["x"]).ravel()
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
        stats["success"],
        stats["return_status"],
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


class _Objective(ca.Callback):
    """One of the functions that IPOPT asks for, from an expansion that all of them share."""

    def __init__(self, name: str, sizes: list[int], shape: tuple[int, int], answer: Callable[..., Any]) -> None:
        ca.Callback.__init__(self)
        self._sizes, self._shape, self._answer = sizes, shape, answer
        self.construct(name, {"enable_fd": False})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shape)

    def eval(self, arg: Any) -> list[ca.DM]:
        return [ca.DM(self._answer(*(np.array(a).ravel() for a in arg)))]


def _solver(problem: LeastSquares, loss: Loss) -> tuple[ca.Function, Callable[[bytes], Expansion], list[_Objective]]:
    """Build IPOPT's solver in coordinates scaled by the priors, and what it expands the objective by.

    The callbacks must live as long as the solver does.
    """
    n = len(problem.model.parameters)

    @lru_cache(maxsize=2)
    def at(point: bytes) -> Expansion:
        return expansion(problem, np.frombuffer(point), loss)

    value = _Objective("value", [n], (1, 1), lambda x: at(x.tobytes()).value + ROUND_OFF * problem.scale)
    gradient = _Objective("gradient", [n], (n, 1), lambda x: at(x.tobytes()).gradient)
    hessian = _Objective("hessian", [n, 1], (n, n), lambda x, factor: float(factor[0]) * at(x.tobytes()).hessian)
    x, p, factor, multipliers = ca.MX.sym("x", n), ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
    options: dict[str, Any] = {
        "grad_f": ca.Function("grad_f", [x, p], [value(x), gradient(x)], ["x", "p"], ["f", "grad_f_x"]),
        "hess_lag": ca.Function(
            "hess_lag", [x, p, factor, multipliers], [ca.triu(hessian(x, factor))],
            ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
        ),
        "no_nlp_grad": True,
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": 200, "nlp_scaling_method": "none",
                  "obj_scaling_factor": 1 / problem.scale, "mu_init": BARRIER, "bound_mult_init_method": "mu-based",
                  "bound_relax_factor": 0.0, "dual_inf_tol": problem.excess},
    }  # fmt: skip
    nlp: Any = {"x": x, "f": value(x)}
    return ca.nlpsol("fit", "ipopt", nlp, options), at, [value, gradient, hessian]
