"""The linear model: a fitted model at its optimum, linearised, and what the data show of its candidates beside it.

The whitened residual e is that at the minimum of the fit's objective. For a candidate with whitened regressors X, the fit's
Jacobian J and the priors' precision P about an offset δ, the information is the Schur complement S = XᵀX - XᵀJ (JᵀJ + P)⁻¹ JᵀX and
the score u = Xᵀe - XᵀJ (JᵀJ + P)⁻¹ (Jᵀe + P δ): uᵀ(S + prior)⁻¹u is the reduction of chi² in a refit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Generic, Self

import numpy as np
import scipy

from calflow.diagnosis.regressors import H, Regressors
from calflow.estimation.forward_substitution import forward
from calflow.estimation.variance_components import LOG_PRIOR, SIZES, directions, explained, log_likelihood
from calflow.model import side_by_side

DRAWN_AT_ONCE = 250  # residuals


@dataclass(frozen=True, eq=False)
class Stack:
    """Candidates with equal numbers of columns d, stacked, as they are beside a whole model.

    members (n_members,): indices of the candidates; columns (n_members, d): of their regressors; sd (n_members, d): of their
    priors; moved (n_members,): their squared effect at one sd; information (n_members, d, d): S; bounds (n_members, 2, d): of the
    parameters.
    """

    members: np.ndarray
    columns: np.ndarray
    sd: np.ndarray
    moved: np.ndarray
    information: np.ndarray
    bounds: np.ndarray

    def only(self, which: np.ndarray) -> Self:
        """Return some of the candidates, given by indices (n,)."""
        return replace(self, **{field.name: getattr(self, field.name)[which] for field in fields(self)})


@dataclass(frozen=True, eq=False)
class LinearModel(Generic[H]):
    """A linearised model with the regressors of all candidates."""

    regressors: Regressors[H]

    @cached_property
    def stacks(self) -> list[Stack]:
        """All candidates, by their numbers of columns."""
        r, stacks = self.regressors, []
        sizes = np.array([len(candidate.columns) for candidate in r.candidates])
        for d in np.unique(sizes):
            members = np.flatnonzero(sizes == d)
            columns = np.array([r.candidates[m].columns for m in members])
            whole, imitated = self._products[0][columns, :d], self.projected[:, columns].transpose(1, 0, 2)
            sd = r.prior_sd[columns]
            moved = np.maximum(np.einsum("mii,mi->m", whole, sd**2), np.finfo(float).tiny)
            bounds = np.array([r.candidates[m].cause.bounds for m in members])
            s = whole - imitated.transpose(0, 2, 1) @ imitated
            stacks.append(Stack(members, columns, sd, moved, s, bounds))
        return stacks

    @cached_property
    def _factor(self) -> np.ndarray:
        """Cholesky factor of the model's information, priors included."""
        r = self.regressors
        return np.linalg.cholesky(r.jacobian.T @ r.jacobian + np.diag(r.precision))

    @cached_property
    def _products(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products over all rows of each regressor with those of its candidate (n_columns, widest), of all with a root of the
        predicted residuals' covariance (n_free, n_columns), and of all with the residual after a Newton step (n_columns,).
        """
        r, root = self.regressors, self.prediction_root
        own = np.zeros((r.matrix.shape[1], max((len(c.columns) for c in r.candidates), default=0)))
        projected, score = np.zeros((len(root), len(own))), np.zeros(len(own))
        for rows, values in r.matrix.blocks():
            for candidate in r.candidates:
                columns = side_by_side(candidate.columns)
                x = values[:, columns]
                own[columns, : len(candidate.columns)] += x.T @ x
            projected += root[:, rows] @ values
            score += values.T @ self.settled_residual[rows]
        return own, projected, score

    @property
    def projected(self) -> np.ndarray:
        """Projection of the regressors on the model's Jacobian, in whitened coordinates (n_free, n_columns)."""
        return self._products[1]

    @cached_property
    def _gradient(self) -> np.ndarray:
        """Gradient of the fit's objective in the same coordinates; zero at an optimum."""
        r = self.regressors
        return forward(self._factor, r.jacobian.T @ r.residual + r.pull)

    @cached_property
    def step(self) -> np.ndarray:
        """Newton step of the free parameters, a background's amplitudes among them, (n_free,)."""
        return np.asarray(-scipy.linalg.solve_triangular(self._factor.T, self._gradient, lower=False))

    @property
    def change(self) -> np.ndarray:
        """Newton step of the model's free parameters."""
        return np.delete(self.step, self.regressors.random)

    @cached_property
    def settled_residual(self) -> np.ndarray:
        """Residual after the Newton step, (n,)."""
        return np.asarray(self.regressors.residual + self.regressors.jacobian @ self.step)

    @cached_property
    def prediction_root(self) -> np.ndarray:
        """A root R (n_free, n) of the covariance RᵀR of the predicted residuals."""
        return forward(self._factor, self.regressors.jacobian.T)

    def root_covariance(self, parameters: np.ndarray) -> np.ndarray:
        """Return a root R (n_free, n) of the covariance RᵀR of some free parameters, given by indices."""
        picked = np.eye(len(self._factor))[:, parameters]
        return forward(self._factor, picked)

    @property
    def score(self) -> np.ndarray:
        """Score u of all columns, (n_columns,)."""
        return self._products[2]

    @cached_property
    def chi2(self) -> float:
        """Chi² of the model, priors included, after a Newton step of its parameters."""
        r = self.regressors
        return float(r.residual @ r.residual + r.prior_rss - self._gradient @ self._gradient)

    def information(self, columns: np.ndarray) -> np.ndarray:
        """Return S between some columns, shape (n_columns, n_columns)."""
        imitated = self.projected[:, columns]
        return np.asarray(self.regressors.matrix.products(columns) - imitated.T @ imitated)

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return S between all columns and some, the change of u by their amplitudes, shape (n_columns, n_own)."""
        shown = self.regressors.matrix.response(columns)
        return np.asarray(shown - self.projected.T @ self.projected[:, columns])

    def settled(
        self, residual: np.ndarray, pull: np.ndarray, size: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return u (n_columns, n_draws) and chi² (n_draws,) of residuals (n, n_draws) times size (n,), so that draws can be signs.

        pull (n_free, n_draws) is that of the priors.
        """
        r, size = self.regressors, np.ones(len(residual)) if size is None else size
        steps = [slice(start, start + DRAWN_AT_ONCE) for start in range(0, residual.shape[1], DRAWN_AT_ONCE)]
        chi2 = (pull**2 / r.precision[:, None]).sum(axis=0)
        gradient = forward(self._factor, pull)
        for draws in steps:
            drawn = size[:, None] * residual[:, draws]
            gradient[:, draws] += self.prediction_root @ drawn
            chi2[draws] += (drawn**2).sum(axis=0)
        score = -self.projected.T @ gradient
        for rows, x in r.matrix.blocks():
            for draws in steps:
                score[:, draws] += x.T @ (size[rows, None] * residual[rows, draws])
        return score, chi2 - (gradient**2).sum(axis=0)

    def imitation(self, columns: np.ndarray) -> np.ndarray:
        """Return the change of the model's free parameters by a unit of some columns, (n, n_columns)."""
        change = -scipy.linalg.solve_triangular(self._factor.T, self.projected[:, columns], lower=False)
        return np.delete(change, self.regressors.random, axis=0)

    def amplitudes(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return posterior probabilities of SIZES of some columns, means (n_sizes, n) and covariances (n_sizes, n, n) for each."""
        sd = self.regressors.prior_sd[columns]
        shown, score = self.information(columns) * np.outer(sd, sd), sd * self.score[columns]
        fallen, narrowed = explained(*directions(shown, score))
        logs = log_likelihood(fallen / self.chi2, narrowed, self.degrees_of_freedom) + LOG_PRIOR
        covariance = np.linalg.inv(shown + np.eye(len(columns)) / SIZES[:, None, None] ** 2)
        return scipy.special.softmax(logs), -sd * (covariance @ score), covariance * np.outer(sd, sd)

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Residual degrees of freedom: number of residuals less that of the effective parameters, a background's left out."""
        r, fixed = self.regressors, self.fixed
        of_priors = self.fixed_root * np.sqrt(r.precision[fixed])
        return float(len(r.residual) - len(fixed) + (of_priors**2).sum())

    @cached_property
    def fixed(self) -> np.ndarray:
        """The indices of the free parameters that are no amplitudes of a background."""
        return np.setdiff1d(np.arange(len(self.regressors.precision)), self.regressors.random)

    @cached_property
    def fixed_root(self) -> np.ndarray:
        """A root R (n_free, n_fixed) of their covariance RᵀR."""
        return self.root_covariance(self.fixed)

    @property
    def narrowed(self) -> float:
        """Log-determinant of the model's information over its priors': the parameters' Occam factor, minus twice its log."""
        return float(2 * np.log(self._factor.diagonal()).sum() - np.log(self.regressors.precision).sum())
