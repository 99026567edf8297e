"""Sweeps: score tests beside a model without some of its parameters, and with candidates as further ones (Goodnight 1979).

Nothing is factored again. With C the covariance RᵀR of the parameters that leave, W = R⁻ᵀ times their response to the candidates,
and h likewise of the way from where they would be to zero, S grows by WᵀW, u by Wᵀh and chi² by hᵀh. Parameters that come lower
them in the same manner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calflow.diagnosis.regressors import H, Regressors
from calflow.diagnosis.screening import ScoreTests, Screening, Stack


@dataclass(frozen=True, eq=False)
class Swept(ScoreTests[H]):
    """Score tests of some candidates beside a whole model that is swept.

    some: indices of the candidates; gone: of the whole model's free parameters that leave it, with their estimates value; come:
    columns of the regressors that become parameters.
    """

    whole: Screening[H]
    some: np.ndarray
    gone: np.ndarray
    value: np.ndarray
    come: np.ndarray

    @cached_property
    def model(self) -> Screening[H]:
        """The swept model."""
        if not len(self._sign):
            return self.whole
        whole = self.whole.regressors
        columns = whole.matrix.only(self.come).times(np.eye(len(self.come)))
        less = whole.without(self.gone, self.value)
        return Screening(less.with_parameters(columns, whole.prior_sd[self.come] ** -2.0))

    @property
    def tested(self) -> np.ndarray:
        """The indices of the candidates."""
        return self.some

    @property
    def linear(self) -> Regressors[H]:
        """The linearised whole model."""
        return self.whole.regressors

    @property
    def stacks(self) -> Sequence[Stack]:
        """All candidates beside the whole model."""
        return self.whole.stacks

    def changed(self, columns: np.ndarray) -> np.ndarray:
        """Return by how much S (n_members, d, d) of columns (n_members, d) is larger than beside the whole model."""
        rows = self._rows[:, columns - self._span.start].transpose(1, 2, 0)
        return np.asarray(rows @ (self._sign[:, None] * rows.transpose(0, 2, 1)))

    def score_of(self, columns: np.ndarray) -> np.ndarray:
        """Return the score u of columns (n_members, d)."""
        moved = np.tensordot(self._sign * self._way, self._rows[:, columns - self._span.start], 1)
        return np.asarray(self.whole.score[columns] + moved)

    @cached_property
    def chi2(self) -> float:
        """Chi² of the swept model."""
        return self.whole.chi2 + float(self._sign @ self._way**2)

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Residual degrees of freedom of the swept model."""
        whole = self.whole
        stay = np.flatnonzero(~np.isin(whole.fixed, self.gone))
        root, precision = whole.fixed_root[:, stay], whole.regressors.precision[whole.fixed[stay]]
        # A covariance is minus what S is of a parameter, of which no residuals tell beside itself.
        variance = (root**2).sum(axis=0) - self._sign @ self._swept(root, np.zeros((len(self.come), len(stay)))) ** 2
        inverse = scipy.linalg.solve_triangular(self._factor, np.eye(len(self.come)), lower=True)
        of_come = (inverse**2).sum(axis=0) @ self.linear.prior_sd[self.come] ** -2.0
        return float(len(whole.regressors.residual) - len(stay) - len(self.come) + precision @ variance + of_come)

    @cached_property
    def _root(self) -> np.ndarray:
        """R⁻ᵀ times a root of the covariance of the parameters that leave, orthonormal rows (n_gone, n_free)."""
        return np.asarray(np.linalg.qr(self.whole.root_covariance(self.gone))[0].T)

    @cached_property
    def _taken(self) -> np.ndarray:
        """What these rows are of the columns that come, (n_gone, n_come)."""
        return np.asarray(self._root @ self.whole.projected[:, self.come])

    @cached_property
    def _factor(self) -> np.ndarray:
        """Cholesky factor of the information, priors included, on the parameters that come."""
        prior = np.diag(self.linear.prior_sd[self.come] ** -2.0)
        return np.linalg.cholesky(self.whole.information(self.come) + self._taken.T @ self._taken + prior)

    def _swept(self, projected: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Return the rows W of columns, of parameters that leave and that come, (n_gone + n_come, n).

        projected (n_free, n): their projections on the whole model; shown (n_come, n): their products with the columns that come.
        """
        out = self._root @ projected
        beside = shown - self.whole.projected[:, self.come].T @ projected + self._taken.T @ out
        return np.vstack([out, scipy.linalg.solve_triangular(self._factor, beside, lower=True)])

    @cached_property
    def _span(self) -> slice:
        """The columns from the first to the last that are tested."""
        columns = [self.linear.candidates[k].columns for k in self.tested]
        return slice(min((c[0] for c in columns), default=0), max((c[-1] + 1 for c in columns), default=0))

    @cached_property
    def _rows(self) -> np.ndarray:
        """The rows W of these columns."""
        shown = self.linear.matrix.response(self.come) if len(self.come) else np.zeros((self._span.stop, 0))
        return self._swept(self.whole.projected[:, self._span], shown[self._span].T)

    @cached_property
    def _sign(self) -> np.ndarray:
        """1 for each parameter that leaves, -1 for each that comes."""
        return np.repeat([1.0, -1.0], [len(self.gone), len(self.come)])

    @cached_property
    def _way(self) -> np.ndarray:
        """The same of the residual, h."""
        triangle = np.linalg.qr(self.whole.root_covariance(self.gone))[1]
        out = scipy.linalg.solve_triangular(triangle.T, -self.value - self.whole.step[self.gone], lower=True)
        score = self.whole.score[self.come] + self._taken.T @ out
        return np.concatenate([out, scipy.linalg.solve_triangular(self._factor, score, lower=True)])
