"""Regressors: what each candidate would do to the residual of a fitted model, whitened, from one Jacobian of all together.

A candidate is a variant of a hypothesis, which is what a test needs to know of a possible cause. Regressors of all rows are a
tall matrix, held in memory where it fits, else worked out anew in every pass over it.

Errors that rows share because they are near each other are in the covariance that tests go by. What the model leaves is white
noise and a background of random effects: V = s² (I + sum over parts of size² Z Zᵀ), each part's Z smooth functions of one
input. Multiplied by (V/s²)^-1/2, residuals and regressors are as independent as the tests want them (generalised least squares:
Aitken 1936).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from calflow.effects import Effect
from calflow.effects.base import Cause, parts
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import Probe, probed, side_by_side


class Hypothesis(Protocol):
    """A possible cause in one of its forms. Two that are equal are the same cause in the same form."""

    @property
    def id(self) -> str:
        """What kind of cause it is."""

    @property
    def part(self) -> str:
        """Where it acts; may be empty."""

    @property
    def joint(self) -> int:
        """Number of the joint or link where it acts, 0 for none."""

    @property
    def place(self) -> tuple[str, str]:
        """What stays the same in all its variants: id and part."""

    @property
    def detail(self) -> str:
        """Its variant in words; empty where there is only one."""

    @property
    def n_parameters(self) -> int:
        """How many parameters it has."""

    @property
    def bounds(self) -> np.ndarray:
        """Least and largest values of its parameters, from nominal, shape (2, n_parameters)."""

    @property
    def family(self) -> str:
        """What to call it where the data do not tell it from others of its family; may be empty."""

    @property
    def alike(self) -> tuple[str, ...]:
        """Ids of what no data of this kind tell from it."""

    def same_form(self, other: Self) -> bool:
        """Whether it and another are forms of the same thing, so that they cannot both act."""


H = TypeVar("H", bound=Hypothesis)


WHITENED_ROWS = 256  # that are whitened at once
SMALL_MODE = 0.02  # of a mode's variance over the noise's: less changes no test


@dataclass(frozen=True, eq=False)
class CorrelatedPart:
    """What one of a background's inputs does: its waves by modes (n_modes, n_waves), and its size's degrees of freedom."""

    waves: np.ndarray
    degrees_of_freedom: float


@dataclass(frozen=True, eq=False)
class ErrorCorrelation:
    """The modes (n, n_modes), orthonormal, of a background, their variance (n_modes,) over the noise's, and its parts."""

    modes: np.ndarray
    variance: np.ndarray
    parts: tuple[CorrelatedPart, ...]

    def whiten(self, values: np.ndarray) -> None:
        """Multiply values (n, …) by (V/s²)^-1/2 in their place: these are the largest arrays of all."""
        along = self.taken(self.modes.T @ values)
        for start in range(0, len(values), WHITENED_ROWS):
            part = slice(start, start + WHITENED_ROWS)
            values[part] -= self.modes[part] @ along

    def taken(self, along: np.ndarray) -> np.ndarray:
        """Return what is taken off along the modes of values that are (n_modes, …) along them."""
        return np.asarray(((1 - (1 + self.variance) ** -0.5) * along.T).T)

    def degrees_of_freedom(self, along: np.ndarray, visible: np.ndarray, of_noise: float) -> np.ndarray:
        """Return those of the variance of each column's amplitude, shape (n_columns,) (Satterthwaite 1946).

        What is uncertain because of a background whose size few waves tell is not as sure as the number of rows suggests.

        Args:
            along: whitened columns, freed of what the model imitates, along the modes, (n_modes, n_columns).
            visible: their squares summed, over modes and all else, (n_columns,).
            of_noise: degrees of freedom of the noise itself.
        """
        along, whole = along / np.sqrt(1 + self.variance)[:, None], np.maximum(visible, np.finfo(float).tiny)
        left, unsure = np.ones(len(whole)), np.zeros(len(whole))
        for part in self.parts:
            share = ((part.waves.T @ along) ** 2).sum(axis=0) / whole
            left -= share
            unsure += share**2 / part.degrees_of_freedom
        return np.asarray(1 / (unsure + np.maximum(left, 0.0) ** 2 / of_noise))


@dataclass(frozen=True, eq=False)
class Background:
    """What no cause explains: random smooth functions of inputs, over the noise, scaled by their size.

    inputs are those of each part, functions are of all; modes (n, n_modes) are directions in which they act, parts hold each part's
    functions in these, (n_modes, n_waves). weight (n,) is what the rows' residuals were multiplied by when they were worked out;
    degrees_of_freedom (n_parts,) are those of the sizes' estimates, gain is twice the logarithm of the likelihood that all parts
    together add; tried is how many parts there might have been.
    """

    inputs: tuple[tuple[str, ...], ...]
    functions: tuple[Effect, ...]
    modes: np.ndarray
    parts: tuple[np.ndarray, ...]
    weight: np.ndarray
    degrees_of_freedom: tuple[float, ...]
    gain: float
    tried: int

    def correlation(self, weight: np.ndarray) -> ErrorCorrelation:
        """Return the correlation of residuals that are multiplied by other weights (n,), of the same noise but for its level."""
        ratio = weight / self.weight
        basis, scaled = np.linalg.qr((ratio / np.median(ratio))[:, None] * self.modes)
        left, value, _ = np.linalg.svd(scaled @ np.hstack(self.parts), full_matrices=False)
        kept = value**2 > SMALL_MODE
        turned = left[:, kept].T @ scaled
        parts = tuple(
            CorrelatedPart(turned @ part, sure) for part, sure in zip(self.parts, self.degrees_of_freedom, strict=True)
        )
        return ErrorCorrelation(basis @ left[:, kept], value[kept] ** 2, parts)


HELD = 100_000_000  # numbers that are kept in memory

Rows = slice | np.ndarray


class TallMatrix:
    """A matrix (n, n_columns) that sums are taken over, some of its rows at a time."""

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        raise NotImplementedError

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield the numbers of some rows and these rows, each row once."""
        raise NotImplementedError

    def across(self, values: np.ndarray) -> np.ndarray:
        """Return its transpose times values (n, …)."""
        return reduce(np.add, (x.T @ values[rows] for rows, x in self.blocks()))

    def products(self, columns: np.ndarray) -> np.ndarray:
        """Return the products of some columns with each other, (n_own, n_own)."""
        parts = (x[:, columns] for _, x in self.blocks())
        return reduce(np.add, (part.T @ part for part in parts))

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return the products of all columns with some, (n_columns, n_own)."""
        return reduce(np.add, (x.T @ x[:, columns] for _, x in self.blocks()))

    def times(self, amplitudes: np.ndarray) -> np.ndarray:
        """Return it times amplitudes (n_columns, …)."""
        product = np.empty((self.shape[0], *amplitudes.shape[1:]))
        for rows, x in self.blocks():
            product[rows] = x @ amplitudes
        return product


@dataclass(frozen=True, eq=False)
class Held(TallMatrix):
    """One whose values (n, n_columns) are in memory."""

    values: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        return self.values.shape[0], self.values.shape[1]

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield all at once."""
        yield slice(None), self.values


@dataclass(frozen=True, eq=False)
class Remade(TallMatrix):
    """What a probe's effects do, of which each pass works out a block of rows after the other.

    correlation is what errors of rows near each other share beside what those of a standstill do: see `Regressors.of`.
    """

    probe: Probe
    correlation: ErrorCorrelation | None

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        return self.probe.shape[0], self.probe.width

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield some hundred rows at a time."""
        for rows, x in self._as_they_are():
            if self.correlation is not None:
                x -= self.correlation.modes[rows] @ self._taken
            yield rows, x

    @cached_property
    def _taken(self) -> np.ndarray:
        """What the correlation takes off along its modes, (n_modes, n_columns)."""
        assert self.correlation is not None
        modes = self.correlation.modes
        return self.correlation.taken(reduce(np.add, (modes[rows].T @ x for rows, x in self._as_they_are())))

    def _as_they_are(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield rows without what those of a standstill share, but whitened by no correlation."""
        for rows, _, slopes in self.probe.parts():
            yield rows, slopes[:, self.probe.n_parameters :]


USUAL = 1e-3  # m, per axis: what a model leaves of a usual robot at most
PASSES = 4  # over all rows that a linearisation is asked for, on average
POSE_FREEDOM = 6  # ways in which a pose can be off, however many points are seen of it


@dataclass(frozen=True)
class Candidate(Generic[H]):
    """One variant of a cause: its regressors are these columns."""

    cause: H
    columns: np.ndarray


@dataclass(frozen=True)
class RegressorProducts:
    """The sums over all rows that tests need, worked out once for a model and for all that is taken out of it.

    fitted (n_free, n_free) are the Jacobian's with itself, mixed (n_free, n_columns) those with the regressors, own
    (n_columns, widest) each regressor's with those of its candidate, squared (n_columns,) each one's with itself; fitted_left
    (n_free,) and left (n_columns,) are those of both with the residual. along_fitted (n_modes, n_free) and along (n_modes,
    n_columns) are what both have in common with the modes of a correlation.
    """

    fitted: np.ndarray
    mixed: np.ndarray
    own: np.ndarray
    squared: np.ndarray
    fitted_left: np.ndarray
    left: np.ndarray
    along_fitted: np.ndarray
    along: np.ndarray

    @staticmethod
    def of(regressors: Regressors) -> RegressorProducts:
        """Add up the products of the residual (n,), the Jacobian (n, n_free) and the regressors (n, n_columns)."""
        residual, jacobian, correlation = regressors.residual, regressors.jacobian, regressors.correlation
        gram = np.zeros((regressors.matrix.shape[1], max((len(c.columns) for c in regressors.candidates), default=0)))
        squared, left = np.zeros(len(gram)), np.zeros(len(gram))
        modes = correlation.modes if correlation else np.zeros((len(residual), 0))
        mixed, along = np.zeros((jacobian.shape[1], len(gram))), np.zeros((modes.shape[1], len(gram)))
        for rows, values in regressors.matrix.blocks():
            for candidate in regressors.candidates:
                columns = candidate.columns
                x = values[:, side_by_side(columns)]
                product = x.T @ x
                gram[columns, : len(columns)] += product
                squared[columns] += product.diagonal()
            mixed += jacobian[rows].T @ values
            left += values.T @ residual[rows]
            along += modes[rows].T @ values
        return RegressorProducts(
            jacobian.T @ jacobian, mixed, gram, squared, jacobian.T @ residual, left, modes.T @ jacobian, along
        )

    def without(self, gone: np.ndarray, value: np.ndarray) -> RegressorProducts:
        """Return the products without some free parameters (their numbers), which have these values."""
        keep = np.setdiff1d(np.arange(len(self.fitted)), gone)
        return replace(
            self,
            fitted=self.fitted[np.ix_(keep, keep)],
            mixed=self.mixed[keep],
            fitted_left=self.fitted_left[keep] - self.fitted[np.ix_(keep, gone)] @ value,
            left=self.left - self.mixed[gone].T @ value,
            along_fitted=self.along_fitted[:, keep],
        )


@dataclass(frozen=True)
class Regressors(Generic[H]):
    """All candidates' whitened regressors side by side, with the model's own Jacobian.

    residual (n,) and jacobian (n, n_free) are the fit's, pull (n_free,) the priors' part of the gradient; matrix is
    (n, n_columns), prior_sd (n_columns,). scale is by how much the candidates' priors are wider than they state. All are whitened
    by the correlation, where there is one. sure (n_columns,) are the degrees of freedom of the variance of each column's
    amplitude, where the correlation does not say so. posed is the share of the residuals that there would be of six a pose at
    most. added_up are the products, where they follow from those of others.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    prior_rss: float
    matrix: TallMatrix
    prior_sd: np.ndarray
    candidates: tuple[Candidate[H], ...]
    scale: float = 1.0
    correlation: ErrorCorrelation | None = None
    sure: np.ndarray | None = None
    posed: float = 1.0
    added_up: RegressorProducts | None = None

    @cached_property
    def products(self) -> RegressorProducts:
        """The sums over all rows."""
        return self.added_up or RegressorProducts.of(self)

    @staticmethod
    def of(
        fit: Fit,
        problem: LeastSquares,
        effects: Sequence[Effect],
        poses: np.ndarray | None = None,
        correlation: ErrorCorrelation | None = None,
    ) -> Regressors[Cause]:
        """Linearise the fitted model with all these effects at zero, which costs one Jacobian.

        What rows of a standstill share is the problem's; poses (n_rows,) numbers the rows by pose, of which six residuals count at
        most. correlation is what errors of rows near each other share besides.
        Where much more is left than usual, causes are looked for that are as much larger than usual.
        """
        model = fit.model
        large = replace(model, probes=tuple(effects))
        n = len(model.parameters)
        probe = Probe.of(problem, fit.estimate, effects)
        tall = probe if math.prod(probe.shape) > HELD else None
        left, slopes = probed(problem, fit.estimate, () if tall else effects)
        left, slopes = problem.decorrelated(left), problem.decorrelated(slopes)
        if correlation is not None:
            correlation.whiten(left)
            correlation.whiten(slopes)
        free = np.flatnonzero(~fit.at_bound)
        offset = fit.estimate - model.prior_mean
        precision = model.prior_sd**-2.0
        scale = max(1.0, problem.scatter / USUAL)
        rows = np.arange(problem.n_rows) if poses is None else poses
        residuals_a_pose = np.bincount(rows[problem.stacking.row])
        matrix = Remade(tall.compiled(PASSES), correlation) if tall else Held(slopes[:, n:])
        return Regressors(
            left,
            slopes[:, free],
            precision[free],
            (precision * offset)[free],
            float(precision @ offset**2),
            matrix,
            large.prior_sd[n:] * scale,
            candidates_of(effects),
            scale,
            correlation,
            posed=float(np.minimum(residuals_a_pose, POSE_FREEDOM).sum() / residuals_a_pose.sum()),
        )

    def without(self, columns: np.ndarray, value: np.ndarray) -> Regressors[H]:
        """Return the regressors of the model without some free parameters (their numbers), which have these values."""
        keep = np.setdiff1d(np.arange(self.jacobian.shape[1]), columns)
        pull = value * np.sqrt(self.precision[columns])
        return replace(
            self,
            residual=self.residual - self.jacobian[:, columns] @ value,
            jacobian=self.jacobian[:, keep],
            precision=self.precision[keep],
            pull=self.pull[keep],
            prior_rss=self.prior_rss - float(pull @ pull),
            added_up=self.products.without(columns, value),
        )

    def only(self, candidates: Sequence[Candidate[H]]) -> Regressors[H]:
        """Return them with some of the candidates."""
        return replace(self, candidates=tuple(candidates), added_up=self.products)

    def moving(self, matrix: TallMatrix) -> Regressors[H]:
        """Return them with candidates that move the residual otherwise: their regressors are another matrix."""
        return replace(self, matrix=matrix, added_up=None)

    def taking(self, columns: np.ndarray) -> Regressors[H]:
        """Return the regressors of the model with some columns as free parameters besides, which have not settled yet."""
        taken = np.zeros((self.matrix.shape[1], len(columns)))
        taken[columns, np.arange(len(columns))] = 1.0
        return replace(
            self,
            jacobian=np.hstack([self.jacobian, self.matrix.times(taken)]),
            precision=np.append(self.precision, self.prior_sd[columns] ** -2.0),
            pull=np.append(self.pull, np.zeros(len(columns))),
            added_up=None,
        )


def candidates_of(effects: Sequence[Effect]) -> tuple[Candidate[Cause], ...]:
    """Return every place of these effects with its columns, effect by effect."""
    candidates, start = [], 0
    for effect in effects:
        if isinstance(effect, Cause):
            size = len(effect.declared)
            candidates.append(Candidate(effect, start + np.arange(size)))
            start += size
            continue
        for part, columns in parts(effect).items():
            candidates.append(Candidate(Cause(effect.robot, effect, part), start + columns))
        start += len(effect.declared)
    return tuple(candidates)
