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

    residual (n,) is whitened by the noise, stacking says what each of them is; r_factor (n_parameters, n_parameters) is
    Householder's R factor of their Jacobian, which tells all of it but the rows. covariance is Laplace's, over the
    parameters off their bounds; a parameter at a bound has zeros there. objective is half of chi² plus half of the priors' part.
    """

    model: Model
    estimate: np.ndarray
    objective: float
    residual: np.ndarray
    stacking: Stacking
    r_factor: np.ndarray
    iterations: int
    converged: bool
    status: str

    @cached_property
    def at_bound(self) -> np.ndarray:
        """Which parameters sit on a bound, shape (n_parameters,)."""
        lower, upper = self.model.bounds.T
        margin = AT_BOUND * np.sqrt(np.diag(self._inverse(np.full(len(self.estimate), True))))
        return (self.estimate < lower + margin) | (self.estimate > upper - margin)

    @cached_property
    def information(self) -> np.ndarray:
        """Gauss-Newton Hessian of the objective, priors included, shape (n_parameters, n_parameters)."""
        return self.r_factor.T @ self.r_factor + np.diag(self.model.prior_sd**-2.0)

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
        starts: parameter values to start from, shape (n_starts, n_parameters); nominal by default.
        loss: how the square of a row's whitened residual counts; soft_l1 and cauchy weigh outliers less.
    """
    solver, expanded, _callbacks = _solver(problem, loss)
    model = problem.model
    starts = model.nominal[None] if starts is None else starts
    lower, upper = model.bounds.T / model.prior_sd
    solutions = []
    for start in starts:
        inside = np.clip(start / model.prior_sd, lower + 1e-3 * (upper - lower), upper - 1e-3 * (upper - lower))
        found = solver(x0=inside, lbx=lower, ubx=upper)
        if solver.stats()["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        at = np.array(found["x"]).ravel()
        solutions.append((expanded(at.tobytes()).value, at, solver.stats()))
    objective, x, stats = min(solutions, key=lambda solution: solution[0])
    agree = sum(other[0] - objective < SAME_OPTIMUM for other in solutions)
    estimate = x * model.prior_sd
    residual, r_factor = _reduced(problem, estimate, loss)
    result = Fit(
        model,
        estimate,
        objective,
        residual,
        problem.stacking,
        r_factor,
        stats["iter_count"],
        stats["success"],
        stats["return_status"],
    )
    return result, agree


def restated(result: Fit, problem: LeastSquares, loss: Loss) -> Fit:
    """Return a fit's residuals and information by the weights of a problem, at the same estimate."""
    residual, r_factor = _reduced(problem, result.estimate, loss)
    return replace(result, residual=residual, r_factor=r_factor)


def _reduced(problem: LeastSquares, estimate: np.ndarray, loss: Loss) -> tuple[np.ndarray, np.ndarray]:
    """The whitened residual, and the r_factor of the information that rows far off give less of."""
    residual, r_factor = problem.reduced(estimate)
    return residual, r_factor if loss == "linear" else problem.reweighted(estimate, loss).reduced(estimate)[1]


def draw_starts(model: Model, n_starts: int, rng: np.random.Generator) -> np.ndarray:
    """Return the nominal values and n_starts - 1 draws from half the prior's width, shape (n_starts, n_parameters)."""
    drawn = model.nominal + 0.5 * model.prior_sd * rng.standard_normal((n_starts - 1, len(model.nominal)))
    return np.vstack([model.nominal, np.clip(drawn, *model.bounds.T)])


@dataclass(frozen=True)
class Expansion:
    """The objective at one point, its gradient and Gauss-Newton Hessian, in coordinates scaled by the priors."""

    value: float
    gradient: np.ndarray
    hessian: np.ndarray


def expansion(problem: LeastSquares, x: np.ndarray, loss: Loss) -> Expansion:
    """Expand the objective about scaled parameters x, block by block of rows, so that memory does not grow with them."""
    model, n = problem.model, len(x)
    offset = x - model.nominal / model.prior_sd
    value, gradient, hessian = 0.5 * offset @ offset, offset.copy(), np.eye(n)
    for _, residual, jacobian in problem.linearised(x * model.prior_sd):
        squared = (residual**2).sum(axis=1)
        slope = rho_slope(squared, loss)[:, None, None]
        scaled = (jacobian * model.prior_sd).reshape(-1, n)
        weighted = scaled if loss == "linear" else (slope * jacobian * model.prior_sd).reshape(-1, n)
        value += 0.5 * float(rho(squared, loss).sum())
        gradient += weighted.T @ residual.ravel()
        hessian += weighted.T @ scaled
    return Expansion(value, gradient, hessian)


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
