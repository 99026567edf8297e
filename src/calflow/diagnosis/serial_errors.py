"""Serial errors: white noise plus an Ornstein-Uhlenbeck process along an order of the rows.

V = (1 - share) I + share R, where R is the process's correlation: between neighbours phi_t = exp(-gap_t / length), times `kept`
where another group begins. At even gaps and a share near 1 this is AR(1); a length far beyond the rows makes it a random walk,
and `kept` zero in addition an error that each group shares.

The process is Markov. With D, which subtracts phi_t times the previous row from each, D R Dᵀ is diagonal and D V Dᵀ tridiagonal,
with Cholesky factor C: C⁻¹ D whitens exactly, at any spacing, in O(n).

Share, length and kept maximise the restricted likelihood (Patterson and Thompson 1971), a model's parameters being integrated
out. Their uncertainty limits the degrees of freedom of tests (Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from calflow.estimation.forward_substitution import forward
from calflow.estimation.variance_components import NormalEquations

RATIO = (1e-2, 1e3)  # bounds of the process's variance over the white noise's
KEPT = (0.01, 0.99)
SHORTEST, LONGEST = 0.3, 10.0  # bounds of the length, over the smallest gap and over the sum of all gaps
RATIOS, LENGTHS, KEPTS = (0.3, 3.0, 100.0), 6, (0.05, 0.9)  # grid of starting points
STEP = 0.1  # of the log hyperparameters, for finite differences
ACCEPTED_GAIN = 3.0  # least gain of twice the log-likelihood for the process to be accepted
GUESSED = 2.0  # prior standard deviation of the log hyperparameters


@dataclass(frozen=True, eq=False)
class RowOrder:
    """An order of rows: distance of each row from the previous, gap (n,), and whether a group begins there, begins (n,)."""

    gap: np.ndarray
    begins: np.ndarray

    @staticmethod
    def sorted(
        n: int, along: np.ndarray | None = None, groups: np.ndarray | None = None
    ) -> tuple[np.ndarray, RowOrder]:
        """Return the rows sorted along a coordinate (n,), ties by group (n,), or by group alone; and their order."""
        group = np.zeros(n, dtype=int) if groups is None else np.unique(groups, return_inverse=True)[1]
        rows = np.argsort(group, kind="stable") if along is None else np.lexsort((group, along))
        gap = np.ones(n) if along is None else np.diff(along[rows], prepend=along[rows[0]])
        return rows, RowOrder(gap, np.diff(group[rows], prepend=group[rows[0]]) != 0)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Bounds (2, n_figures) of log ratio, log length and, with groups, the logit of kept."""
        gaps = self.gap[1:][self.gap[1:] > 0]
        shortest, longest = (gaps.min(), gaps.sum()) if len(gaps) else (1.0, 1.0)
        ends = [np.log(RATIO), np.log([SHORTEST * shortest, LONGEST * longest])]
        return np.transpose([*ends, scipy.special.logit(KEPT)] if self.begins.any() else ends)

    @property
    def starts(self) -> Iterator[np.ndarray]:
        """Starting points of the search for the likeliest figures."""
        shortest, longest = self.bounds[:, 1]
        lengths = np.linspace(shortest, longest, LENGTHS)
        kept = [scipy.special.logit(KEPTS)] if self.begins.any() else []
        return (np.array(start) for start in product(np.log(RATIOS), lengths, *kept))


@dataclass(frozen=True, eq=False)
class SerialErrors:
    """Serial errors along an order; figures (n_figures,) are log ratio, log length and the logit of kept."""

    order: RowOrder
    figures: np.ndarray

    @property
    def share(self) -> float:
        """Share of the variance that is the process's."""
        return float(scipy.special.expit(self.figures[0]))

    @property
    def length(self) -> float:
        """Distance along the order at which its correlation has fallen to 1/e."""
        return float(np.exp(self.figures[1]))

    @property
    def kept(self) -> float:
        """Factor of its correlation where another group begins; 1 without groups."""
        return float(scipy.special.expit(self.figures[2])) if len(self.figures) > 2 else 1.0

    @cached_property
    def _neighbours(self) -> np.ndarray:
        """Correlation of the process at each row with that at the previous row, (n,); 0 for the first."""
        phi = np.exp(-self.order.gap / self.length) * np.where(self.order.begins, self.kept, 1.0)
        phi[0] = 0.0
        return np.asarray(phi)

    @cached_property
    def _factor(self) -> np.ndarray:
        """C in LAPACK's band storage, (2, n)."""
        phi, white = self._neighbours, 1 - self.share
        band = np.zeros((2, len(phi)))
        band[0] = self.share * (1 - phi**2) + white * (1 + phi**2)
        band[1, :-1] = -white * phi[1:]
        band[0, 0] = 1.0
        return np.asarray(scipy.linalg.lapack.dpbtrf(band, lower=1)[0])

    @property
    def log_determinant(self) -> float:
        """Log-determinant of V."""
        return float(2 * np.log(self._factor[0]).sum())

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, …) times V^-1/2."""
        apart = np.array(values, dtype=float)
        apart[1:] -= (self._neighbours[1:] * values[:-1].T).T
        return np.asarray(scipy.linalg.lapack.dtbtrs(self._factor, apart, uplo="L")[0]).reshape(values.shape)


@dataclass(frozen=True, eq=False)
class RestrictedLikelihood:
    """Restricted likelihood of the covariance of a linear model's errors.

    residual (n,): residual at an estimate; design (n, n_parameters): Jacobian by parameters scaled by their priors; pull
    (n_parameters,): the scaled estimate; level: approximate standard deviation of the errors; degrees_of_freedom: residual ones.
    """

    residual: np.ndarray
    design: np.ndarray
    pull: np.ndarray
    level: float
    degrees_of_freedom: float

    @cached_property
    def _both(self) -> np.ndarray:
        """Design and residual side by side, (n, n_parameters + 1)."""
        return np.column_stack([self.design, self.residual])

    @cached_property
    def _prior(self) -> np.ndarray:
        """Products of the parameters' prior, (n_parameters + 1, n_parameters + 1)."""
        none = NormalEquations(np.zeros((len(self.pull) + 1,) * 2), 0)
        return none.with_prior(self.pull, np.full(len(self.pull), self.level**2)).products

    def variance(self, errors: SerialErrors | None) -> float:
        """Return the maximum-likelihood variance of the errors."""
        return self._equations(errors).restricted_likelihood(self.degrees_of_freedom)[0]

    def cost(self, errors: SerialErrors | None) -> float:
        """Return minus twice the restricted log-likelihood."""
        restricted = self._equations(errors).restricted_likelihood(self.degrees_of_freedom)[1]
        return restricted + (errors.log_determinant if errors else 0.0)

    def _equations(self, errors: SerialErrors | None) -> NormalEquations:
        both = self._both if errors is None else errors.whitened(self._both)
        return NormalEquations(both.T @ both + self._prior, len(both))

    def likeliest(self, order: RowOrder) -> LikelyErrors | None:
        """Return the likeliest serial errors; None where independent errors are about as likely."""
        errors = SerialErrors(order, np.zeros(order.bounds.shape[1]))

        def cost(figures: np.ndarray) -> float:
            return self.cost(replace(errors, figures=figures))

        start = min(order.starts, key=cost)
        best = scipy.optimize.minimize(cost, start, method="L-BFGS-B", bounds=order.bounds.T, options={"eps": 1e-4})
        if self.cost(None) - best.fun < ACCEPTED_GAIN:
            return None
        return LikelyErrors(order, best.x, self)


@dataclass(frozen=True, eq=False)
class LikelyErrors(SerialErrors):
    """The serial errors of maximum restricted likelihood."""

    likelihood: RestrictedLikelihood

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the figures; those at a bound are taken as known."""
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
        """Minus twice the log of the figures' posterior over prior volume (uniform within bounds): their Occam factor."""
        free = self.covariance.diagonal() > 0
        log_prior = np.linalg.slogdet(2 * np.pi * self.covariance[np.ix_(free, free)])[1]
        return float(2 * np.log(np.ptp(self.order.bounds, axis=0))[free].sum() - log_prior)

    def degrees_of_freedom(self, design: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (n_columns,) of each regressor's amplitude's variance, beside a design (n, n_fitted)."""
        shown = self._log_slopes(lambda errors: self._visible(errors, design, columns))
        return self._satterthwaite(self._level_slopes[:, None] - shown)

    @property
    def level_degrees_of_freedom(self) -> float:
        """Degrees of freedom of the errors' variance."""
        return float(self._satterthwaite(self._level_slopes[:, None])[0])

    @cached_property
    def _level_slopes(self) -> np.ndarray:
        """Derivative of the log maximum-likelihood variance by each figure, (n_figures,)."""
        return self._log_slopes(self.likelihood.variance)

    def _log_slopes(self, value: Callable[[SerialErrors], np.ndarray | float]) -> np.ndarray:
        """Return the derivative by each figure of the logarithm of a value of the errors, (n_figures, …)."""
        steps = STEP * np.eye(len(self.figures))
        less, more = (
            np.log(np.array([value(SerialErrors(self.order, figures)) for figures in self.figures + side]))
            for side in (-steps, steps)
        )
        return np.asarray((more - less) / (2 * STEP))

    def _satterthwaite(self, slopes: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom of variances whose logarithms have slopes (n_figures, n_variances)."""
        of_figures = np.einsum("ac,ab,bc->c", slopes, self.covariance, slopes)
        return np.asarray(2 / (of_figures + 2 / self.likelihood.degrees_of_freedom))

    def _visible(self, errors: SerialErrors, design: np.ndarray, columns: np.ndarray) -> np.ndarray:
        design, columns = errors.whitened(design), errors.whitened(columns)
        information = design.T @ design + self.likelihood.level**2 * np.eye(design.shape[1])
        imitated = forward(np.linalg.cholesky(information), design.T @ columns)
        shown = (columns**2).sum(axis=0)
        return np.asarray(np.maximum(shown - (imitated**2).sum(axis=0), 1e-12 * shown + np.finfo(float).tiny))
