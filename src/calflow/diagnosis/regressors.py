"""Regressors: the whitened Jacobian of a fitted model's residuals by the parameters of all candidate causes.

A candidate is one variant of a hypothesis, the interface of a possible cause for tests. Regressors of all rows form a tall
matrix, held in memory where it fits, else recomputed in each pass over it.

Errors correlated between nearby rows are white noise and a background of random effects, V = s² (I + Z Zᵀ). The amplitudes of Z
are further parameters with a standard normal prior, which for the others is generalised least squares with V (Henderson 1975).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, reduce
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import Probe
from calflow.estimation.smooth_functions import SmoothFunction
from calflow.model import consecutive, side_by_side

SMALL_MODE = 0.02  # a mode's variance over the noise's, below which it changes no test
HELD = 100_000_000  # matrix entries that are kept in memory
USUAL = 1e-3  # m, per axis: largest usual standard deviation of a robot's residuals
PASSES = 4  # over all rows per linearisation, on average
POSE_FREEDOM = 6  # degrees of freedom of a pose's error, however many points are seen of it

Place = tuple[str, str]  # of a cause: its id and part


class Hypothesis(Protocol):
    """A possible cause in one of its forms. Two that are equal are the same cause in the same form.

    id: its kind; part: that on which it acts, may be empty; joint: number of the joint or link, 0 for none; place: id and part,
    which all its variants share; detail: its variant in words, empty where there is only one; bounds (2, n_parameters): of its
    parameters relative to nominal; family: name used where the data do not distinguish its members, may be empty; alike: ids of
    causes that no data of this kind distinguish from it.
    """

    @property
    def id(self) -> str: ...
    @property
    def part(self) -> str: ...
    @property
    def joint(self) -> int: ...
    @property
    def place(self) -> Place: ...
    @property
    def detail(self) -> str: ...
    @property
    def n_parameters(self) -> int: ...
    @property
    def bounds(self) -> np.ndarray: ...
    @property
    def family(self) -> str: ...
    @property
    def alike(self) -> tuple[str, ...]: ...
    def same_form(self, other: Self) -> bool:
        """Whether it and another are forms of the same cause, so that they cannot both act."""
        ...


H = TypeVar("H", bound=Hypothesis)


@dataclass(frozen=True, eq=False)
class Background:
    """Errors that no cause explains: random smooth functions of inputs, standard normal times their effects.

    inputs: inputs of each part; functions: basis functions of all parts; effects (n, n_modes): principal effects on the residuals,
    whitened by weight (n,); gain: twice the log-likelihood that all parts add; tried: number of parts that were considered.
    """

    inputs: tuple[tuple[str, ...], ...]
    functions: tuple[SmoothFunction, ...]
    effects: np.ndarray
    weight: np.ndarray
    gain: float
    tried: int

    def at(self, weight: np.ndarray) -> np.ndarray:
        """Return the effects on residuals with other whitening factors (n,), equal but for the noise's level."""
        ratio = weight / self.weight
        return np.asarray((ratio / np.median(ratio))[:, None] * self.effects)


def principal(modes: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return the principal effects of a background's parts, (n_modes, n_waves) each over the noise, along modes (n, n_modes)."""
    variance, axes = np.linalg.eigh(sum(part @ part.T for part in parts))
    return np.asarray(modes @ (axes * np.sqrt(np.maximum(variance, 0.0)))[:, variance > SMALL_MODE])


Rows = slice | np.ndarray


@dataclass(frozen=True, eq=False)
class TallMatrix:
    """A matrix of a shape (n, n_columns) that is read in blocks: indices of some rows and these rows, each row once."""

    shape: tuple[int, int]
    blocks: Callable[[], Iterable[tuple[Rows, np.ndarray]]]

    @staticmethod
    def held(values: np.ndarray) -> TallMatrix:
        """Return a matrix that is held in memory, values (n, n_columns), as a single block."""
        return TallMatrix((len(values), values.shape[1]), lambda: [(slice(None), values)])

    @staticmethod
    def remade(probe: Probe) -> TallMatrix:
        """Return the regressors of a probe's effects, recomputed in each pass, some hundred rows at a time."""

        def blocks() -> Iterator[tuple[slice, np.ndarray]]:
            for rows, _, slopes in probe.parts():
                yield rows, slopes[:, probe.n_parameters :]

        return TallMatrix((probe.shape[0], probe.width), blocks)

    def only(self, columns: np.ndarray) -> TallMatrix:
        """Return some columns, (n, n_own)."""
        kept = side_by_side(columns)
        return TallMatrix((self.shape[0], len(columns)), lambda: ((rows, x[:, kept]) for rows, x in self.blocks()))

    def products(self, columns: np.ndarray) -> np.ndarray:
        """Return the Gram matrix of some columns, (n_own, n_own)."""
        kept = side_by_side(columns)
        parts = (x[:, kept] for _, x in self.blocks())
        return reduce(np.add, (part.T @ part for part in parts))

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return the products of all columns with some, (n_columns, n_own)."""
        return reduce(np.add, (x.T @ x[:, side_by_side(columns)] for _, x in self.blocks()))

    def times(self, amplitudes: np.ndarray) -> np.ndarray:
        """Return the matrix times amplitudes (n_columns, …)."""
        product = np.empty((self.shape[0], *amplitudes.shape[1:]))
        for rows, x in self.blocks():
            product[rows] = x @ amplitudes
        return product


@dataclass(frozen=True)
class Candidate(Generic[H]):
    """One variant of a cause, and the columns of its regressors."""

    cause: H
    columns: np.ndarray


@dataclass(frozen=True)
class Regressors(Generic[H]):
    """The whitened regressors of all candidates, with the residual and Jacobian of the model.

    residual (n,), jacobian (n, n_free), precision (n_free,): the fit's, with its priors; pull (n_free,): the priors' part of the
    gradient; matrix (n, n_columns): regressors, with prior_sd (n_columns,); random (n_modes,): indices of a background's amplitudes
    among the free parameters; amplitude_freedom (n_columns,): degrees of freedom of the variance of each column's amplitude, where
    errors are correlated without one; posed: share of the residuals that remains if at most six per pose count.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    prior_rss: float
    matrix: TallMatrix
    prior_sd: np.ndarray
    candidates: tuple[Candidate[H], ...]
    random: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    amplitude_freedom: np.ndarray | None = None
    posed: float = 1.0

    def with_parameters(self, columns: np.ndarray, precision: np.ndarray) -> Regressors[H]:
        """Return the model with further free parameters, still at zero, by their columns (n, n_more) and priors (n_more,)."""
        return replace(
            self,
            jacobian=np.hstack([self.jacobian, columns]),
            precision=np.append(self.precision, precision),
            pull=np.append(self.pull, np.zeros(len(precision))),
        )

    @staticmethod
    def of(
        fit: Fit,
        problem: LeastSquares,
        effects: Sequence[Effect],
        poses: np.ndarray | None = None,
        background: Background | None = None,
    ) -> Regressors[Cause]:
        """Return the fitted model linearised with all these effects at zero, by one Jacobian, and a background beside it.

        The problem has the correlation within standstills, the background that between nearby rows. poses (n_rows,) numbers the
        rows' poses, of which at most six residuals count. Where residuals are larger than usual, the candidates' priors are widened
        in proportion; those of causes in the model are their usual ones here.
        """
        effects = tuple(effect.usual if isinstance(effect, Cause) else effect for effect in effects)
        model = fit.model
        large = replace(model, probes=tuple(effects))
        n = len(model.parameters)
        probe = Probe.of(problem, fit.estimate, effects)
        tall = probe if math.prod(probe.shape) > HELD else None
        left, slopes = (Probe.of(problem, fit.estimate, ()) if tall else probe).whole()
        free = np.flatnonzero(~fit.at_bound)
        offset = fit.estimate - model.prior_mean
        precision = model.prior_sd**-2.0
        scale = max(1.0, problem.scatter() / USUAL)
        rows = np.arange(problem.n_rows) if poses is None else poses
        residuals_a_pose = np.bincount(rows[problem.row])
        matrix = TallMatrix.remade(tall.compiled(PASSES)) if tall else TallMatrix.held(slopes[:, n:])
        alone = Regressors(
            left,
            slopes[:, free],
            precision[free],
            (precision * offset)[free],
            float(precision @ offset**2),
            matrix,
            large.prior_sd[n:] * scale,
            candidates_of(effects),
            posed=float(np.minimum(residuals_a_pose, POSE_FREEDOM).sum() / residuals_a_pose.sum()),
        )
        return alone.beside(background, problem.weight)

    def beside(self, background: Background | None, weight: np.ndarray) -> Regressors[H]:
        """Return the model beside a background, if there is one, with whitening factors (n,) of the residuals."""
        if background is None:
            return self
        effects, n = background.at(weight), len(self.precision)
        more = self.with_parameters(effects, np.ones(effects.shape[1]))
        return replace(more, random=np.arange(n, len(more.precision)))

    def without(self, columns: np.ndarray, value: np.ndarray) -> Regressors[H]:
        """Return the regressors of the model with some free parameters (by index) removed, whose estimates are value."""
        keep = np.setdiff1d(np.arange(self.jacobian.shape[1]), columns)
        pull = value * np.sqrt(self.precision[columns])
        return replace(
            self,
            residual=self.residual - self.jacobian[:, columns] @ value,
            jacobian=self.jacobian[:, keep],
            precision=self.precision[keep],
            pull=self.pull[keep],
            random=np.flatnonzero(np.isin(keep, self.random)),
            prior_rss=self.prior_rss - float(pull @ pull),
        )

    def moving(self, matrix: TallMatrix) -> Regressors[H]:
        """Return a copy with another matrix of regressors, of which none is a candidate's."""
        return replace(self, matrix=matrix, candidates=())


def candidates_of(effects: Sequence[Effect]) -> tuple[Candidate[Cause], ...]:
    """Return a candidate with its columns for each place of the effects, effect by effect."""
    spans = zip(effects, consecutive(len(effect.declared) for effect in effects), strict=True)
    return tuple(Candidate(own.cause, span.start + own.columns) for effect, span in spans for own in _places(effect))


@lru_cache(maxsize=4096)
def _places(effect: Effect) -> tuple[Candidate[Cause], ...]:
    """Return the candidates of one effect; cached, as their causes keep what they state."""
    if isinstance(effect, Cause):
        return (Candidate(effect, np.arange(len(effect.declared))),)
    return tuple(
        Candidate(Cause(effect.robot, effect, part), np.array(columns)) for part, columns in effect.parts.items()
    )
