"""The diagnosis without a robot: which blocks of regressors a fitted model lacks, how sure that is, and what else it may be.

It is the robot's own: the same screening, family of tests, gate, stepwise search with exchanges, and verdict. Only what that
does by another fit is exact here, since the problem is linear; and residuals far off the others are not weighed down. Errors that
hang together along an order, or in groups, are in the covariance that everything goes by (see `serial_errors`), with the figures
that are likeliest beside each model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy

from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.regressors import Candidate, Held, Regressors
from calflow.diagnosis.screening import Family, Score
from calflow.diagnosis.serial_errors import LikelyErrors, RestrictedLikelihood, RowOrder
from calflow.diagnosis.stepwise import (
    SPLIT,
    Amplitudes,
    CauseAcceptance,
    Detection,
    Linearisation,
    Screened,
    Stepwise,
    Trial,
    refitted_cost,
    verified,
)
from calflow.diagnosis.verdict import verdict
from calflow.files.problems import Problem, refuse_any
from calflow.files.toml import Count, FalseAlarm, checked_arguments

__all__ = [
    "Block", "LinearAdequacy", "LinearDiagnosis", "LinearFinding", "LinearNoise", "LinearRival", "diagnose_linear",
]  # fmt: skip

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
    (n_fitted,) their standard deviations. noise_known says whether sigma is the noise rather than only its proportions; order is
    that along which errors may hang together, None where they are taken to be independent.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    prior_sd: np.ndarray
    blocks: tuple[Block, ...]
    matrix: np.ndarray
    noise_known: bool
    order: RowOrder | None

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
        alone = self._settled(self.residual, design, sd, bounds, level, self.noise_known)
        if self.order is None:
            return alone
        free = ~alone.at_bound
        likelihood = RestrictedLikelihood(
            residual=alone.residual * alone.level,
            design=(design * sd)[:, free],
            pull=(alone.estimate / sd)[free],
            level=alone.level,
            degrees_of_freedom=max(1.0, len(self.residual) - alone.effective_parameters),
        )
        errors = likelihood.likeliest(self.order)
        if errors is None:
            return replace(alone, likelihood=likelihood)
        both = errors.whitened(np.column_stack([self.residual, design]))
        beside = self._settled(both[:, 0], both[:, 1:], sd, bounds, float(np.sqrt(likelihood.variance(errors))), False)
        return replace(beside, likelihood=likelihood, errors=errors)

    def _settled(
        self, residual: np.ndarray, design: np.ndarray, sd: np.ndarray, bounds: np.ndarray, level: float, known: bool
    ) -> Solution:
        solution = _solved(residual, design, sd, bounds, level)
        for _ in range(LEVELS):
            before, level = level, _level(solution, known)
            if np.isclose(level, before, rtol=1e-6):
                break
            solution = _solved(residual, design, sd, bounds, level)
        return solution


@dataclass(frozen=True, eq=False)
class Solution:
    """The parameters (n_parameters,) of what is fitted, then of the blocks; residual (n,) and design are in units of level.

    level is the noise in units of sigma; at_bound (n_parameters,) says which parameters are held by a bound. errors are those that
    residual and design are whitened by, None for independent ones; likelihood is what they were judged by.
    """

    level: float
    estimate: np.ndarray
    prior_sd: np.ndarray
    at_bound: np.ndarray
    residual: np.ndarray
    design: np.ndarray
    likelihood: RestrictedLikelihood | None = None
    errors: LikelyErrors | None = None

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
        tested = np.isin(np.flatnonzero(free), columns)
        covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(tested)))[np.ix_(tested, tested)]
        return float(np.linalg.slogdet(covariance)[1])

    @property
    def misfit(self) -> float:
        """Chi², and the priors'."""
        return float(self.residual @ self.residual + ((self.estimate / self.prior_sd) ** 2).sum())


def _level(solution: Solution, known: bool) -> float:
    """What is left over sigma, per degree of freedom; 1 where the noise is known and that is no significant lack of fit."""
    left = float((solution.residual**2).sum()) * solution.level**2
    degrees_of_freedom = max(1.0, len(solution.residual) - solution.effective_parameters)
    if known and scipy.stats.chi2.sf(left, degrees_of_freedom) > LACK_OF_FIT:
        return 1.0
    return float(np.sqrt(left / degrees_of_freedom))


def _solved(residual: np.ndarray, design: np.ndarray, sd: np.ndarray, bounds: np.ndarray, level: float) -> Solution:
    left, scaled = residual / level, design * sd / level
    factor = np.linalg.cholesky(scaled.T @ scaled + np.eye(len(sd)))
    target = np.linalg.solve(factor, -scaled.T @ left)
    optimum, (lower, upper) = np.linalg.solve(factor.T, target), bounds / sd
    held = np.zeros(len(sd), dtype=bool)
    if ((optimum < lower) | (optimum > upper)).any():
        inside = scipy.optimize.lsq_linear(factor.T, target, (lower, upper), method="bvls")
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
        narrowed = solution.narrowed(np.concatenate([[], *spans]).astype(int))
        return refitted_cost(misfit, self.degrees_of_freedom, every, narrowed) + self._cost_of_errors

    @property
    def _cost_of_errors(self) -> float:
        """What errors cost that hang together, beyond independent ones: their figures, and the volumes that they spread over."""
        solution, fitted = self.solution, len(self.problem.prior_sd)
        if solution.errors is None:
            return 0.0
        volumes = []
        for design in (self.problem.jacobian, solution.design[:, :fitted] * solution.level):
            scaled = design * self.problem.prior_sd
            volumes.append(np.linalg.slogdet(scaled.T @ scaled + solution.level**2 * np.eye(fitted))[1])
        return float(solution.errors.log_determinant + solution.errors.narrowed + volumes[1] - volumes[0])

    def _amplitudes(self, block: Block, columns: np.ndarray) -> Amplitudes:
        solution, variants = self.solution, sum(block.name == other.name for other in self.problem.blocks)
        return Amplitudes.of(
            solution.estimate[columns], solution.prior_sd[columns], solution.at_bound[columns], variants
        )

    @cached_property
    def linearisation(self) -> Linearisation[Block]:
        """The solved problem with the regressors of all blocks, those in the model too."""
        solution, problem = self.solution, self.problem
        errors = solution.errors
        shown = problem.matrix if errors is None else errors.whitened(problem.matrix)
        free = np.flatnonzero(~solution.at_bound)
        precision = solution.prior_sd**-2.0
        regressors = Regressors(
            residual=solution.residual,
            jacobian=solution.design[:, free],
            precision=precision[free],
            pull=(precision * solution.estimate)[free],
            prior_rss=float(precision @ solution.estimate**2),
            matrix=Held(shown / solution.level),
            prior_sd=np.concatenate([block.sd for block in problem.blocks]),
            candidates=problem.candidates,
            sure=None
            if errors is None
            else errors.degrees_of_freedom(problem.jacobian * problem.prior_sd, problem.matrix),
        )
        columns = tuple(np.flatnonzero(np.isin(free, span)) for span in self._own)
        return Linearisation(self.blocks, regressors, solution.estimate[free], columns)

    @property
    def _own(self) -> list[np.ndarray]:
        """Each block's columns of the design."""
        ends = len(self.problem.prior_sd) + np.cumsum([0, *(block.n_parameters for block in self.blocks)])
        return [np.arange(i, j) for i, j in pairwise(ends)]


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
    data do not exclude (a cost within 10), the nearest first; one that is "unexplained" is no block: errors that hang together.
    """

    name: str
    variant: str
    estimate: np.ndarray
    sd: np.ndarray
    p: float
    probability: float
    rivals: tuple[LinearRival, ...]


@dataclass(frozen=True)
class LinearNoise:
    """What the model with its findings leaves, taken for noise.

    level is its standard deviation over the noise that was given, or in the residuals' unit where none was, and degrees_of_freedom
    say how well that is known: those of as many independent residuals. A share of its variance hangs together along the order, over
    a length in the order's unit, and where another group begins what is kept of it; 0, 0 and 1 where nothing hangs together.
    """

    level: float
    degrees_of_freedom: float
    share: float
    length: float
    kept: float

    @staticmethod
    def of(solution: Solution) -> LinearNoise:
        """Return that of a solved problem."""
        errors = solution.errors
        if errors is None:
            left = len(solution.residual) - solution.effective_parameters
            return LinearNoise(solution.level, float(left), 0.0, 0.0, 1.0)
        return LinearNoise(solution.level, errors.level_degrees_of_freedom, errors.share, errors.length, errors.kept)


@dataclass(frozen=True)
class LinearAdequacy:
    """Whether the model with its findings is enough, as far as the data tell.

    lack_of_fit is the chance of as much as it leaves, with the noise that was given and independent; None where none was: then
    what it leaves cannot be told from noise. together is the chance of neighbours that are as alike as those of what is left,
    once what hangs together as the noise says is taken out.
    """

    lack_of_fit: float | None
    together: float

    @staticmethod
    def of(solution: Solution, independent: Solution, noise_known: bool) -> LinearAdequacy:
        """Return that of a solved problem, also solved with independent errors."""
        residual = solution.residual
        alike = float(residual[1:] @ residual[:-1] / (residual @ residual)) * np.sqrt(len(residual))
        left = float((independent.residual**2).sum()) * independent.level**2
        freedom = max(1.0, len(residual) - independent.effective_parameters)
        p = float(scipy.stats.chi2.sf(left, freedom)) if noise_known else None
        return LinearAdequacy(p, float(2 * scipy.stats.norm.sf(abs(alike))))

    @property
    def statement(self) -> str:
        """The same in words."""
        if self.lack_of_fit is None:
            words = "Whether the model lacks something cannot be told: the noise is not known."
        elif self.lack_of_fit > LACK_OF_FIT:
            words = f"What is left is no more than the noise (p = {self.lack_of_fit:.2g})."
        else:
            words = f"What is left is more than the noise (p = {self.lack_of_fit:.2g})."
        if self.together < LACK_OF_FIT:
            words += f" It is correlated from row to row beyond what the noise explains (p = {self.together:.2g})."
        return words


@dataclass(frozen=True)
class LinearDiagnosis:
    """What was found, in the order in which it was, and the names of what these data cannot show in any variant.

    noise is what is left, and adequacy whether that is no more than it should be.
    """

    findings: tuple[LinearFinding, ...]
    untestable: tuple[str, ...]
    noise: LinearNoise
    adequacy: LinearAdequacy


@checked_arguments
def diagnose_linear(
    residual: np.ndarray,
    jacobian: np.ndarray,
    candidates: Sequence[Block],
    *,
    rng: np.random.Generator,
    prior_sd: np.ndarray | None = None,
    noise: np.ndarray | float | None = None,
    order: np.ndarray | None = None,
    groups: np.ndarray | None = None,
    false_alarm: FalseAlarm = FALSE_ALARM,
    most: Count = 10,
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
        order: (n,) numbers along which rows follow each other, a time say: errors of rows that are near may hang together. None:
            as the rows stand, those of a group together.
        groups: (n,) numbers, equal where residuals that follow each other may share an error; where they do, it counts once.
            None: there are none.
        false_alarm: chance that anything at all is found where nothing is hidden.
        most: how many blocks to find at most.

    Raises:
        InputError: shapes do not match, or figures are not finite or of no use, all of them named.
    """
    residual, jacobian = np.asarray(residual, dtype=float), np.asarray(jacobian, dtype=float)
    refuse_any(map(Problem, _problems(residual, jacobian, candidates, prior_sd, noise, order, groups)))
    sigma = np.broadcast_to(1.0 if noise is None else noise, residual.shape)
    whitened, design = residual / sigma, jacobian / sigma[:, None]
    matrix = np.hstack([block.matrix for block in candidates]) / sigma[:, None]
    prior = _flat(whitened, design) if prior_sd is None else np.asarray(prior_sd, dtype=float)
    rows, row_order = RowOrder.sorted(len(residual), None if order is None else np.asarray(order, dtype=float), groups)
    problem = LinearProblem(
        whitened[rows], design[rows], prior, tuple(candidates), matrix[rows], noise is not None, row_order
    )
    search = _found(problem, CauseAcceptance(false_alarm, most), rng)
    unnamed = _unnamed(search.best)
    detections = [
        replace(detection, unnamed=unnamed[detection.cause]) for detection in verified(search.best, search.tried)
    ]
    return LinearDiagnosis(
        tuple(map(_finding, detections)),
        tuple(dict.fromkeys(block.name for block in candidates if block.name not in _shown(search.best))),
        LinearNoise.of(search.best.solution),
        LinearAdequacy.of(
            search.best.solution, replace(problem, order=None).solved(search.best.blocks), problem.noise_known
        ),
    )


def _shown(trial: Trial[Block]) -> set[str]:
    """Names of what could be seen beside what is fitted anyway."""
    looked = trial.linearisation
    return {score.cause.name for score in (looked.apart(trial.causes) if trial.causes else looked.beside).scores}


@dataclass(frozen=True)
class Search:
    """What a search began with, and ended with: the best model, all that were tried, and the first screening."""

    start: LinearTrial
    best: LinearTrial
    tried: Sequence[Trial[Block]]
    first: Screened[Block]

    @staticmethod
    def of(problem: LinearProblem, acceptance: CauseAcceptance, rng: np.random.Generator, *blocks: Block) -> Search:
        """Search on from a model with some blocks."""
        first = LinearTrial(Family({}, 1.0), len(problem.residual), problem).linearisation.screened(rng)
        start = LinearTrial(first.family, first.degrees_of_freedom, problem)
        further = [start.with_causes(blocks)] if blocks else []
        best, tried = Stepwise(acceptance, first, rng, lambda _: None, lambda _: None).best(start, *further)
        return Search(start, start.with_causes(best.causes), tried, first)


def _found(problem: LinearProblem, acceptance: CauseAcceptance, rng: np.random.Generator) -> Search:
    """Search with errors that may hang together: from nothing, and from what is found where they are taken not to.

    What is smooth along the order looks like such errors until it is in the model, and they look like it until they are. A block
    must explain the data clearly better than errors that hang together do in its place.
    """
    independent = Search.of(replace(problem, order=None), acceptance, rng)
    start = replace(independent.start, problem=problem)
    beside = start.with_causes(independent.best.causes)
    if start.solution.errors is None and beside.solution.errors is None:
        return independent
    ended = [Search.of(problem, acceptance, rng)]
    if beside.blocks:
        ended.append(Search.of(problem, acceptance, rng, *beside.blocks))
    best = min(ended, key=lambda search: search.best.cost + SPLIT * len(search.best.causes))
    while losing := {cause: cost for cause, cost in _unnamed(best.best).items() if cost < SPLIT}:
        weakest = min(losing, key=lambda cause: losing[cause])
        best = replace(best, best=best.best.with_causes([cause for cause in best.best.causes if cause is not weakest]))
    return best


def _unnamed(trial: LinearTrial) -> dict[Block, float]:
    """Return the cost of errors that hang together in each block's place, above its own; infinite where they do not."""
    without = {
        block: trial.with_causes([other for other in trial.blocks if other is not block]) for block in trial.blocks
    }
    return {block: other.cost - trial.cost if other.solution.errors else np.inf for block, other in without.items()}


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
    order: np.ndarray | None,
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
    for name, figures in (("order", order), ("groups", groups)):
        if figures is not None and np.shape(figures) != (n,):
            problems.append(f"{name}: expected shape ({n},), found {np.shape(figures)}")
        elif figures is not None and not np.isfinite(np.asarray(figures, dtype=float)).all():
            problems.append(f"{name}: has figures that are not finite")
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
