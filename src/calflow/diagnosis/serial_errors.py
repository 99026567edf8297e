"""Serial errors: white noise beside a process that forgets, along an order in which rows follow each other.

V = (1 - share) I + share R, where R is the correlation of an Ornstein-Uhlenbeck process: between neighbours it is
phi_t = exp(-gap_t / length), times `kept` where another group begins. At even gaps and a share near 1 that is AR(1); a length far
beyond the rows, a random walk; a length as far and `kept` zero, an error that each group shares.

The process is Markov. With D, which takes phi_t times the row before from each row, D R Dᵀ is diagonal and D V Dᵀ tridiagonal,
of Cholesky factor C: C⁻¹ D whitens exactly, at any spacing, in O(n).

Share, length and what is kept are those of the greatest restricted likelihood (Patterson and Thompson 1971) beside a model: its
parameters are integrated out. How sure they are limits how sure any test is (Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import scipy

RATIO = (1e-2, 1e3)  # of the process's variance over the white noise's
KEPT = (0.01, 0.99)
SHORTEST, LONGEST = 0.3, 10.0  # length, over the smallest gap and over all gaps together
RATIOS, LENGTHS, KEPTS = (0.3, 3.0, 100.0), 6, (0.05, 0.9)  # where the search for the likeliest begins
STEP = 0.1  # of logarithms, for derivatives
BELIEVED = 3.0  # in twice the logarithm of the likelihood: what the process must add to be kept
GUESSED = 2.0  # standard deviation of what is known of the logarithms beforehand


@dataclass(frozen=True, eq=False)
class RowOrder:
    """How far each row is from the one before, gap (n,), and whether another group begins there, begins (n,)."""

    gap: np.ndarray
    begins: np.ndarray

    @staticmethod
    def sorted(
        n: int, along: np.ndarray | None = None, groups: np.ndarray | None = None
    ) -> tuple[np.ndarray, RowOrder]:
        """Sort rows along numbers (n,), those of a group (n,) together where they are equal; by group where there are none."""
        group = np.zeros(n, dtype=int) if groups is None else np.unique(groups, return_inverse=True)[1]
        rows = np.argsort(group, kind="stable") if along is None else np.lexsort((group, along))
        gap = np.ones(n) if along is None else np.diff(along[rows], prepend=along[rows[0]])
        return rows, RowOrder(gap, np.diff(group[rows], prepend=group[rows[0]]) != 0)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Least and largest ratio, length, and where there are groups what is kept, as logarithms (2, n_figures)."""
        gaps = self.gap[1:][self.gap[1:] > 0]
        shortest, longest = (gaps.min(), gaps.sum()) if len(gaps) else (1.0, 1.0)
        ends = [np.log(RATIO), np.log([SHORTEST * shortest, LONGEST * longest])]
        return np.transpose([*ends, scipy.special.logit(KEPT)] if self.begins.any() else ends)

    @property
    def starts(self) -> Iterator[np.ndarray]:
        """Where the search for the likeliest figures begins."""
        shortest, longest = self.bounds[:, 1]
        lengths = np.linspace(shortest, longest, LENGTHS)
        kept = [scipy.special.logit(KEPTS)] if self.begins.any() else []
        return (np.array(start) for start in product(np.log(RATIOS), lengths, *kept))


@dataclass(frozen=True, eq=False)
class SerialErrors:
    """Errors along an order with these figures (n_figures,): logarithms of ratio and length, and the logit of what is kept."""

    order: RowOrder
    figures: np.ndarray

    @property
    def share(self) -> float:
        """Share of the variance that the process has."""
        return float(scipy.special.expit(self.figures[0]))

    @property
    def length(self) -> float:
        """Distance along the order at which its correlation has fallen to 1/e."""
        return float(np.exp(self.figures[1]))

    @property
    def kept(self) -> float:
        """What its correlation is multiplied by where another group begins; 1 where there are no groups."""
        return float(scipy.special.expit(self.figures[2])) if len(self.figures) > 2 else 1.0

    @cached_property
    def _neighbours(self) -> np.ndarray:
        """Correlation of each row's process with the row's before, (n,); 0 for the first."""
        phi = np.exp(-self.order.gap / self.length) * np.where(self.order.begins, self.kept, 1.0)
        phi[0] = 0.0
        return np.asarray(phi)

    @cached_property
    def _factor(self) -> np.ndarray:
        """C as LAPACK holds a band, (2, n)."""
        phi, white = self._neighbours, 1 - self.share
        band = np.empty((2, len(phi)))
        band[0] = self.share * (1 - phi**2) + white * (1 + phi**2)
        band[1] = np.append(-white * phi[1:], 0.0)
        band[0, 0] = 1.0
        return np.asarray(scipy.linalg.cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False))

    @property
    def log_determinant(self) -> float:
        """The logarithm of the determinant of V."""
        return float(2 * np.log(self._factor[0]).sum())

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, …) times V^-1/2."""
        apart = np.array(values, dtype=float)
        apart[1:] -= (self._neighbours[1:] * values[:-1].T).T
        return np.asarray(scipy.linalg.solve_banded((1, 0), self._factor, apart, overwrite_b=True, check_finite=False))


@dataclass(frozen=True, eq=False)
class RestrictedLikelihood:
    """What a linear model leaves of rows, to judge their errors by.

    residual (n,) is what it leaves at an estimate, design (n, n_parameters) its derivative by its parameters over their priors,
    pull (n_parameters,) the estimate likewise; level is about the errors' standard deviation; degrees_of_freedom are those that
    the model leaves.
    """

    residual: np.ndarray
    design: np.ndarray
    pull: np.ndarray
    level: float
    degrees_of_freedom: float

    def variance(self, errors: SerialErrors | None) -> float:
        """Return the likeliest variance of the errors."""
        return self._judged(errors)[0]

    def cost(self, errors: SerialErrors | None) -> float:
        """Return twice minus the logarithm of the likelihood."""
        return self._judged(errors)[1]

    @cached_property
    def _both(self) -> np.ndarray:
        """Residual and design side by side, (n, 1 + n_parameters)."""
        return np.column_stack([self.residual, self.design])

    def _judged(self, errors: SerialErrors | None) -> tuple[float, float]:
        both = self._both if errors is None else errors.whitened(self._both)
        left, design = both[:, 0], both[:, 1:]
        factor = np.linalg.cholesky(design.T @ design + self.level**2 * np.eye(len(self.pull)))
        aim = design.T @ left + self.level**2 * self.pull
        settled = scipy.linalg.solve_triangular(factor, aim, lower=True, check_finite=False)
        chi2 = float(left @ left + self.level**2 * self.pull @ self.pull - settled @ settled)
        variance = max(chi2 / self.degrees_of_freedom, 1e-300)
        cost = self.degrees_of_freedom * np.log(variance) + 2 * np.log(factor.diagonal()).sum()
        return variance, float(cost) + (errors.log_determinant if errors else 0.0)

    def likeliest(self, order: RowOrder) -> LikelyErrors | None:
        """Return the likeliest serial errors; none where independent ones are about as likely."""
        errors = SerialErrors(order, np.zeros(order.bounds.shape[1]))

        def cost(figures: np.ndarray) -> float:
            return self.cost(replace(errors, figures=figures))

        start = min(order.starts, key=cost)
        best = scipy.optimize.minimize(cost, start, method="L-BFGS-B", bounds=order.bounds.T, options={"eps": 1e-4})
        if self.cost(None) - best.fun < BELIEVED:
            return None
        return LikelyErrors(order, best.x, self)


@dataclass(frozen=True, eq=False)
class LikelyErrors(SerialErrors):
    """The likeliest serial errors, by a likelihood."""

    likelihood: RestrictedLikelihood

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the figures; what is at a bound is taken to be there."""
        k = len(self.figures)
        steps = STEP * np.eye(k)
        inside = np.all(np.abs(self.figures - self.order.bounds) > STEP, axis=0)

        def cost(change: np.ndarray) -> float:
            return self.likelihood.cost(SerialErrors(self.order, self.figures + change))

        mixed = [[cost(a + b) - cost(a - b) - cost(b - a) + cost(-a - b) for b in steps] for a in steps]
        information = np.where(np.outer(inside, inside), np.array(mixed) / (8 * STEP**2), 0.0)
        value, vectors = np.linalg.eigh(information)
        whole = (vectors / (np.maximum(value, 0.0) + GUESSED**-2.0)) @ vectors.T
        return np.asarray(np.where(np.outer(inside, inside), whole, 0.0))

    @property
    def narrowed(self) -> float:
        """What it costs to have figures that might have been anywhere within their bounds, -2 log."""
        free = self.covariance.diagonal() > 0
        log_prior = np.linalg.slogdet(2 * np.pi * self.covariance[np.ix_(free, free)])[1]
        return float(2 * np.log(np.ptp(self.order.bounds, axis=0))[free].sum() - log_prior)

    def degrees_of_freedom(self, design: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return those of the variance of each column's amplitude, shape (n_columns,).

        Args:
            design: the derivative by the parameters that are fitted anyway over their priors, (n, n_fitted), not whitened.
            columns: (n, n_columns), not whitened either.
        """
        level, less, more = self._level_slopes, *self._beside
        shown = [[self._visible(errors, design, columns) for errors in side] for side in (less, more)]
        return self._satterthwaite(level[:, None] - np.log(np.divide(shown[1], shown[0])) / (2 * STEP))

    @property
    def level_degrees_of_freedom(self) -> float:
        """Those of the errors' variance."""
        return float(self._satterthwaite(self._level_slopes[:, None])[0])

    @property
    def _beside(self) -> tuple[list[SerialErrors], list[SerialErrors]]:
        """Errors with each figure a step less, and with each a step more."""
        less, more = ([SerialErrors(self.order, self.figures + step) for step in side * np.eye(len(self.figures))]
                      for side in (-STEP, STEP))  # fmt: skip
        return less, more

    @cached_property
    def _level_slopes(self) -> np.ndarray:
        """Derivative of the logarithm of the likeliest variance by each figure, (n_figures,)."""
        less, more = ([np.log(self.likelihood.variance(errors)) for errors in side] for side in self._beside)
        return (np.array(more) - less) / (2 * STEP)

    def _satterthwaite(self, slopes: np.ndarray) -> np.ndarray:
        """Degrees of freedom of variances whose logarithms have slopes (n_figures, n_variances)."""
        of_figures = np.einsum("ac,ab,bc->c", slopes, self.covariance, slopes)
        return np.asarray(2 / (of_figures + 2 / self.likelihood.degrees_of_freedom))

    def _visible(self, errors: SerialErrors, design: np.ndarray, columns: np.ndarray) -> np.ndarray:
        design, columns = errors.whitened(design), errors.whitened(columns)
        information = design.T @ design + self.likelihood.level**2 * np.eye(design.shape[1])
        imitated = scipy.linalg.solve_triangular(np.linalg.cholesky(information), design.T @ columns, lower=True)
        shown = (columns**2).sum(axis=0)
        return np.asarray(np.maximum(shown - (imitated**2).sum(axis=0), 1e-12 * shown + np.finfo(float).tiny))
