"""The diagnosis without a robot: which blocks of regressors a fitted model lacks, how sure that is, and what else it may be.

It is the robot's own: the same screening, family of tests, gate, stepwise search with exchanges, and verdict. Only what that
does by another fit is exact here, since the problem is linear; and residuals far off the others are not weighed down.

A linear problem with some of its blocks in the model, solved exactly: a trial of the search without a robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import chi2 as chi2_distribution

from calflow.diagnosis.regressors import Candidate, Held, RegressorProducts, Regressors, counted_once, shared_error
from calflow.diagnosis.screening import Family, Score
from calflow.diagnosis.stepwise import (
    FALSE_ALARM,
    Amplitudes,
    CauseAcceptance,
    Detection,
    Linearisation,
    Stepwise,
    Trial,
    refitted_cost,
    verified,
)
from calflow.diagnosis.verdict import verdict
from calflow.files.problems import InputError, Problem

LACK_OF_FIT = 0.01  # significance from which a model leaves more than noise that is known
LEVELS = 20  # rounds in which noise that is not known settles, at most


@dataclass(frozen=True, eq=False)
class Block:
    """A possible cause in one variant, which is a hypothesis of the screening: what its parameters do to the residuals.

    name says what and where it is, the same for all variants; variant which form this is. matrix (n, n_parameters) is the
    derivative of the residuals by its parameters, in the residuals' unit a parameter's unit. prior_sd (n_parameters,), or one
    for all, is the usual size of the parameters about zero; lower and upper, likewise, are what they cannot exceed.
    """

    name: str
    matrix: np.ndarray
    prior_sd: np.ndarray | float
    variant: str = ""
    lower: np.ndarray | float = -np.inf
    upper: np.ndarray | float = np.inf

    part = ""
    joint = 0
    family = ""
    alike = ()

    @property
    def id(self) -> str:
        """Its name."""
        return self.name

    @property
    def place(self) -> tuple[str, str]:
        """What stays the same in all its variants."""
        return self.name, ""

    @property
    def detail(self) -> str:
        """Its variant."""
        return self.variant

    @property
    def n_parameters(self) -> int:
        """How many parameters it has."""
        return int(self.matrix.shape[1])

    @property
    def bounds(self) -> np.ndarray:
        """Least and largest values of its parameters, shape (2, n_parameters)."""
        return np.array([np.broadcast_to(bound, self.n_parameters) for bound in (self.lower, self.upper)], dtype=float)

    @property
    def sd(self) -> np.ndarray:
        """Its parameters' prior standard deviations, shape (n_parameters,)."""
        return np.array(np.broadcast_to(self.prior_sd, self.n_parameters), dtype=float)

    def same_form(self, other: Block) -> bool:
        """Whether another is a variant of the same."""
        return self.name == other.name


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """What is left of measurements, what is fitted to them, and what else there may be; all over sigma.

    residual (n,) is at the means of the fitted parameters' priors, jacobian (n, n_fitted) its derivative by them, prior_sd
    (n_fitted,) their standard deviations. group (n,) numbers residuals that share an error; noise_known says whether sigma is
    the noise rather than only its proportions.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    prior_sd: np.ndarray
    blocks: tuple[Block, ...]
    matrix: np.ndarray
    noise_known: bool
    group: np.ndarray | None

    @cached_property
    def candidates(self) -> tuple[Candidate[Block], ...]:
        """Each block with its columns of matrix."""
        ends = np.cumsum([0, *(block.n_parameters for block in self.blocks)])
        return tuple(Candidate(b, np.arange(i, j)) for b, i, j in zip(self.blocks, ends[:-1], ends[1:], strict=True))

    def columns(self, blocks: Sequence[Block]) -> np.ndarray:
        """Return the columns of matrix that are some blocks'."""
        columns = {candidate.cause: candidate.columns for candidate in self.candidates}
        return np.concatenate([np.zeros(0, dtype=int), *(columns[block] for block in blocks)])

    def solved(self, blocks: Sequence[Block]) -> Solution:
        """Return the most probable parameters with some blocks in the model, within the bounds."""
        sd = np.concatenate([self.prior_sd, *(block.sd for block in blocks)])
        free = np.full((2, len(self.prior_sd)), [[-np.inf], [np.inf]])
        bounds = np.hstack([free, *(block.bounds for block in blocks)])
        design = np.hstack([self.jacobian, self.matrix[:, self.columns(blocks)]])
        level = 1.0 if self.noise_known else float(np.sqrt(np.mean(self.residual**2)))
        solution = _solved(self.residual, design, sd, bounds, level)
        for _ in range(LEVELS):
            before, level = level, self._level(solution)
            if np.isclose(level, before, rtol=1e-6):
                break
            solution = _solved(self.residual, design, sd, bounds, level)
        return solution

    def _level(self, solution: Solution) -> float:
        """What is left over sigma, per degree of freedom; 1 where the noise is known and that is no significant lack of fit."""
        left = float((solution.residual**2).sum()) * solution.level**2
        degrees_of_freedom = max(1.0, len(solution.residual) - solution.effective_parameters)
        if self.noise_known and chi2_distribution.sf(left, degrees_of_freedom) > LACK_OF_FIT:
            return 1.0
        return float(np.sqrt(left / degrees_of_freedom))


@dataclass(frozen=True, eq=False)
class Solution:
    """The parameters (n_parameters,) of what is fitted, then of the blocks; residual (n,) and design are in units of level.

    level is the noise in units of sigma; at_bound (n_parameters,) says which parameters are held by a bound.
    """

    level: float
    estimate: np.ndarray
    prior_sd: np.ndarray
    at_bound: np.ndarray
    residual: np.ndarray
    design: np.ndarray

    @cached_property
    def effective_parameters(self) -> float:
        """How many parameters the data determine."""
        scaled = (self.design * self.prior_sd)[:, ~self.at_bound]
        shown = np.linalg.svd(scaled, compute_uv=False) ** 2
        return float((shown / (shown + 1)).sum())

    def narrowed(self, columns: np.ndarray) -> float:
        """Return the logarithm of the determinant of some parameters' covariance, in units of their priors, those held left out."""
        free = ~self.at_bound
        scaled = (self.design * self.prior_sd)[:, free]
        own = np.isin(np.flatnonzero(free), columns)
        covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(own)))[np.ix_(own, own)]
        return float(np.linalg.slogdet(covariance)[1])

    @property
    def misfit(self) -> float:
        """Chi², and the priors'."""
        return float(self.residual @ self.residual + ((self.estimate / self.prior_sd) ** 2).sum())


def _solved(residual: np.ndarray, design: np.ndarray, sd: np.ndarray, bounds: np.ndarray, level: float) -> Solution:
    left, scaled = residual / level, design * sd / level
    factor = np.linalg.cholesky(scaled.T @ scaled + np.eye(len(sd)))
    target = np.linalg.solve(factor, -scaled.T @ left)
    optimum, (lower, upper) = np.linalg.solve(factor.T, target), bounds / sd
    held = np.zeros(len(sd), dtype=bool)
    if ((optimum < lower) | (optimum > upper)).any():
        inside = lsq_linear(factor.T, target, (lower, upper), method="bvls")
        optimum, held = inside.x, inside.active_mask != 0
    return Solution(level, optimum * sd, sd, held, left + scaled @ optimum, design / level)


@dataclass(frozen=True)
class LinearTrial(Trial[Block]):
    """The problem with some blocks in the model."""

    problem: LinearProblem
    blocks: tuple[Block, ...] = ()

    @property
    def causes(self) -> tuple[Block, ...]:
        """The blocks."""
        return self.blocks

    @property
    def n_residuals(self) -> int:
        """How many residuals there are."""
        return len(self.problem.residual)

    @cached_property
    def solution(self) -> Solution:
        """The problem's solution with the blocks."""
        return self.problem.solved(self.blocks)

    def with_causes(self, causes: Sequence[Block], added: Score[Block] | None = None) -> LinearTrial:
        """Solve the problem with these blocks instead."""
        return replace(self, blocks=tuple(causes))

    @cached_property
    def cost(self) -> float:
        """What it costs, to be compared with other trials: misfit, parameters, and the variants that were tried."""
        solution, spans = self.solution, self._own
        every = [self._amplitudes(block, columns) for block, columns in zip(self.blocks, spans, strict=True)]
        misfit = (solution.misfit - sum(amplitudes.pulled for amplitudes in every)) * solution.level**2
        return refitted_cost(
            misfit, self.n_residuals, every, solution.narrowed(np.concatenate([[], *spans]).astype(int))
        )

    def _amplitudes(self, block: Block, columns: np.ndarray) -> Amplitudes:
        free = columns[~self.solution.at_bound[columns]]
        pulled = float(((self.solution.estimate[free] / self.solution.prior_sd[free]) ** 2).sum())
        variants = sum(block.name == other.name for other in self.problem.blocks)
        return Amplitudes(pulled, len(free), len(columns) - len(free), variants)

    @cached_property
    def linearisation(self) -> Linearisation[Block]:
        """The solved problem with the regressors of all blocks, those in the model too."""
        solution, problem, n = self.solution, self.problem, self.solution.design.shape[1]
        residual, both = solution.residual, np.hstack([solution.design, problem.matrix / solution.level])
        if problem.group is not None:
            shared, _ = shared_error(residual, problem.group, solution.effective_parameters)
            residual, both = (counted_once(values, problem.group, shared) for values in (residual, both))
        free = np.flatnonzero(~solution.at_bound)
        precision = solution.prior_sd**-2.0
        jacobian, matrix = both[:, free], Held(both[:, n:])
        regressors = Regressors(
            residual=residual,
            jacobian=jacobian,
            precision=precision[free],
            pull=(precision * solution.estimate)[free],
            prior_rss=float(precision @ solution.estimate**2),
            matrix=matrix,
            prior_sd=np.concatenate([block.sd for block in problem.blocks]),
            candidates=problem.candidates,
            products=RegressorProducts.of(residual, jacobian, matrix, problem.candidates),
            determined=solution.effective_parameters,
        )
        columns = tuple(np.flatnonzero(np.isin(free, span)) for span in self._own)
        return Linearisation(self.blocks, regressors, solution.estimate[free], columns)

    @property
    def _own(self) -> list[np.ndarray]:
        """Each block's columns of the design."""
        ends = len(self.problem.prior_sd) + np.cumsum([0, *(block.n_parameters for block in self.blocks)])
        return [np.arange(i, j) for i, j in pairwise(ends)]


__all__ = ["Block", "LinearDiagnosis", "LinearFinding", "LinearRival", "diagnose_linear"]

FLAT = 1e4  # by how much a parameter without a prior may move the residuals, over their length


@dataclass(frozen=True)
class LinearRival:
    """What else may explain the data: a block's name, its best variant, and its cost above the finding's (variants averaged)."""

    name: str
    variant: str
    cost: float


@dataclass(frozen=True, eq=False)
class LinearFinding:
    """A block that the model lacks.

    estimate and sd (n_parameters,) are in the parameters' units, sd nan at a bound; p is the chance that anything in the family
    looks like this where nothing is hidden, probability that it is this block rather than a rival; rivals are those that the
    data do not exclude (a cost within 10), the nearest first.
    """

    name: str
    variant: str
    estimate: np.ndarray
    sd: np.ndarray
    p: float
    probability: float
    rivals: tuple[LinearRival, ...]


@dataclass(frozen=True)
class LinearDiagnosis:
    """What was found, in the order in which it was, and the names of what these data cannot show in any variant."""

    findings: tuple[LinearFinding, ...]
    untestable: tuple[str, ...]


def diagnose_linear(
    residual: np.ndarray,
    jacobian: np.ndarray,
    candidates: Sequence[Block],
    *,
    rng: np.random.Generator,
    prior_sd: np.ndarray | None = None,
    noise: np.ndarray | float | None = None,
    groups: np.ndarray | None = None,
    false_alarm: float = FALSE_ALARM,
    most: int = 10,
) -> LinearDiagnosis:
    """Find the blocks that explain what a linear, or linearised, model leaves of measurements.

    Residuals are predictions minus measurements (or the other way round, the matrices' sign with them), at the means of the
    fitted parameters' priors, or at any estimate where there are no priors: those parameters are fitted here again.

    Args:
        residual: (n,), in any unit.
        jacobian: its derivative by the parameters that are fitted anyway, shape (n, n_fitted).
        candidates: what the model may lack, all variants of each; see `Block`.
        rng: draws the bootstrap that tells how many tests the candidates are worth.
        prior_sd: standard deviations (n_fitted,) of the fitted parameters about the means; None: nothing is known of them.
        noise: standard deviation of the residuals, (n,) or one for all, in their unit; None: it is the same for all and not
            known. What a model leaves beyond it, where that is significant (1 %), is added in proportion.
        groups: (n,) numbers, equal where residuals may share an error; where they do, it counts once. None: none do.
        false_alarm: chance that anything at all is found where nothing is hidden.
        most: how many blocks to find at most.

    Raises:
        InputError: shapes do not match, or figures are not finite or of no use, all of them named.
    """
    residual, jacobian = np.asarray(residual, dtype=float), np.asarray(jacobian, dtype=float)
    if problems := _problems(residual, jacobian, candidates, prior_sd, noise, groups):
        raise InputError(Problem(message) for message in problems)
    sigma = np.broadcast_to(1.0 if noise is None else noise, residual.shape)
    whitened, design = residual / sigma, jacobian / sigma[:, None]
    matrix = np.hstack([block.matrix for block in candidates]) / sigma[:, None]
    prior = _flat(whitened, design) if prior_sd is None else np.asarray(prior_sd, dtype=float)
    group = None if groups is None else np.unique(groups, return_inverse=True)[1]
    problem = LinearProblem(whitened, design, prior, tuple(candidates), matrix, noise is not None, group)
    first = LinearTrial(Family({}, 1.0), problem).linearisation.screened(rng)
    search = Stepwise(CauseAcceptance(false_alarm, most), first, rng, lambda _: None, lambda _: None)
    best, tried = search.best(LinearTrial(first.family, problem))
    return LinearDiagnosis(
        tuple(map(_finding, verified(best, tried))), tuple(dict.fromkeys(block.name for block in first.hidden))
    )


def _finding(finding: Detection[Block]) -> LinearFinding:
    named, score = verdict(finding), finding.own
    rivals = tuple(
        LinearRival(rival.id, rival.cause.detail if rival.cause else "", rival.cost) for rival in named.rivals
    )
    held = (score.estimate == finding.cause.bounds).any(axis=0)
    sd = np.where(held, np.nan, np.sqrt(np.diag(score.covariance)))
    cause = finding.cause
    return LinearFinding(cause.name, cause.variant, score.estimate, sd, finding.p, named.probability, rivals)


def _flat(residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Standard deviations (n_fitted,) of priors that hold back nothing, and keep what the data do not show from drifting."""
    length = np.linalg.norm(jacobian, axis=0)
    return np.asarray(FLAT * np.linalg.norm(residual) / np.where(length > 0, length, 1.0))


def _problems(
    residual: np.ndarray,
    jacobian: np.ndarray,
    candidates: Sequence[Block],
    prior_sd: np.ndarray | None,
    noise: np.ndarray | float | None,
    groups: np.ndarray | None,
) -> list[str]:
    """Everything that is wrong with what was given."""
    if residual.ndim != 1:
        return [f"residual: expected shape (n,), found {residual.shape}"]
    n = len(residual)
    problems = []
    if jacobian.ndim != 2 or len(jacobian) != n:
        problems.append(f"jacobian: expected shape ({n}, n_fitted), found {jacobian.shape}")
    elif n <= jacobian.shape[1]:
        problems.append(f"residual: expected more than the {jacobian.shape[1]} fitted parameters, found {n}")
    elif prior_sd is not None and np.shape(prior_sd) != jacobian.shape[1:]:
        problems.append(f"prior_sd: expected shape {jacobian.shape[1:]}, found {np.shape(prior_sd)}")
    problems += [f"{name}: has figures that are not finite" for name, array in (("residual", residual), ("jacobian", jacobian))
              if not np.isfinite(array).all()]  # fmt: skip
    if not residual.any():
        problems.append("residual: is zero throughout, nothing is left to explain")
    for name, figure in (("prior_sd", prior_sd), ("noise", noise)):
        if figure is not None and not (np.isfinite(figure) & (np.asarray(figure) > 0)).all():
            problems.append(f"{name}: expected figures above 0")
    if noise is not None and np.shape(noise) not in ((), (n,)):
        problems.append(f"noise: expected one figure or shape ({n},), found {np.shape(noise)}")
    if groups is not None and np.shape(groups) != (n,):
        problems.append(f"groups: expected shape ({n},), found {np.shape(groups)}")
    if not candidates:
        problems.append("candidates: expected at least one block")
    for block in candidates:
        problems += [f"candidate {' '.join(filter(None, (block.name, block.variant)))}: {m}" for m in _wrong(block, n)]
    return problems


def _wrong(block: Block, n: int) -> list[str]:
    """Everything that is wrong with a block for so many residuals."""
    shape = np.shape(block.matrix)
    if len(shape) != 2 or shape[0] != n or not shape[1]:
        return [f"expected a matrix of shape ({n}, n_parameters), found {shape}"]
    if any(np.shape(figure) not in ((), shape[1:]) for figure in (block.prior_sd, block.lower, block.upper)):
        return [f"expected one figure or shape {shape[1:]} for prior_sd, lower and upper"]
    problems = [] if np.isfinite(block.matrix).all() else ["its matrix has figures that are not finite"]
    if not (np.isfinite(block.sd) & (block.sd > 0)).all():
        problems.append("expected a prior_sd above 0")
    lower, upper = block.bounds
    if not ((lower <= 0) & (upper >= 0) & (lower < upper)).all():
        problems.append("expected lower <= 0 <= upper, and lower < upper: zero is where it does nothing")
    return problems
