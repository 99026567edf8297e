"""Diagnosis of a linear model: which blocks of regressors it lacks, with what certainty, and which rivals the data allow.

The method is that of the robot's diagnosis: screening, family-wise error control, stepwise search with exchanges, and verdict. The
refits are exact here, since the problem is linear. Serially correlated errors, along an order or in groups, enter the covariance
(see `serial_errors`), with variance parameters of maximum restricted likelihood for each model. Outliers of the model found are
down-weighted (Geman and McClure 1985), and the search is repeated, since they hide causes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.screening import Family, Score
from calflow.diagnosis.serial_errors import LikelyErrors, RestrictedLikelihood, RowOrder
from calflow.diagnosis.stepwise import CLEAR, SPLIT, CauseAcceptance, Stepwise
from calflow.diagnosis.trial import Detection, Linearisation, Screened, Trial
from calflow.diagnosis.verdict import verdict
from calflow.estimation.prior_scale import on_likeliest_scale
from calflow.estimation.progress import nobody
from calflow.estimation.variance_components import refitted_cost
from calflow.files.deferred import pd
from calflow.files.problems import MOST_TOLD, Problem, refuse, refuse_any, run_checks
from calflow.files.toml import Count, FalseAlarm, checked_arguments
from calflow.model import consecutive

__all__ = [
    "Block", "LinearAdequacy", "LinearDiagnosis", "LinearFinding", "LinearNoise", "LinearRival", "diagnose_linear",
]  # fmt: skip

LACK_OF_FIT = 0.01  # significance level of the lack-of-fit test against known noise
APART = 0.01  # significance level of rows that lie apart, over all rows
MEDIAN_EFFICIENCY = (
    0.37  # of the median absolute deviation, relative to the standard deviation's of normal errors (Hampel 1974)
)
WEIGHINGS = 3  # searches at most after the first, in which the weights of outliers settle
SETTLED = 1.1  # excess of an outlier over its limit below which its weight has settled
SCALINGS = 4  # most solutions in which the scales of the blocks' priors settle
LEVELS = 20  # most iterations of an unknown noise level
UNRESTRICTED = 1e4  # prior sd of a parameter without a prior, by its effect on the residuals relative to their norm


@dataclass(frozen=True, eq=False)
class Block:
    """A possible cause in one variant: a block of regressors with priors, one hypothesis of the screening.

    name identifies the cause, and is the same for all its variants. matrix (n, n_parameters) is the Jacobian of the residuals
    by the block's parameters, in units of the residuals per unit of the parameters. prior_sd, lower and upper (n_parameters,),
    or scalars, are the parameters' usual sizes (prior standard deviations about zero), and their bounds. Of a size that is clearly
    beyond prior_sd the data decide: larger ones are rarer, but not excluded.

    Raises:
        InputError: a matrix, prior_sd, lower or upper that are not numbers.
    """

    name: str
    matrix: np.ndarray
    prior_sd: np.ndarray | float
    variant: str = ""
    lower: np.ndarray | float = -np.inf
    upper: np.ndarray | float = np.inf

    def __post_init__(self) -> None:
        for field in ("matrix", "prior_sd", "lower", "upper"):
            object.__setattr__(self, field, _numbers(f"candidate {self.name}: {field}", getattr(self, field)))

    part = ""
    joint = 0
    family = ""
    alike = ()

    @property
    def id(self) -> str:
        """The block's name."""
        return self.name

    @property
    def place(self) -> tuple[str, str]:
        """Name and part, which all variants share."""
        return self.name, ""

    @property
    def detail(self) -> str:
        """The block's variant."""
        return self.variant

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return int(self.matrix.shape[1])

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds of the parameters, shape (2, n_parameters)."""
        return np.array([np.broadcast_to(bound, self.n_parameters) for bound in (self.lower, self.upper)], dtype=float)

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of the parameters, shape (n_parameters,)."""
        return np.array(np.broadcast_to(self.prior_sd, self.n_parameters), dtype=float)

    def same_form(self, other: Block) -> bool:
        """Whether another block is a variant of the same cause."""
        return self.name == other.name


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """A linear regression with priors and candidate blocks; residuals and Jacobians are divided by sigma.

    residual (n,) is at the prior means of the fitted parameters, jacobian (n, n_fitted) its Jacobian by them, prior_sd (n_fitted,)
    their prior standard deviations, and matrix the blocks' Jacobians side by side. noise_known: whether sigma is the absolute
    noise, or only known up to a factor; order: the order of serially correlated errors, None for independent ones.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    prior_sd: np.ndarray
    blocks: tuple[Block, ...]
    matrix: np.ndarray
    noise_known: bool
    order: RowOrder | None

    def weighed(self, factor: np.ndarray) -> LinearProblem:
        """Return the problem with each row's noise enlarged by a factor (n,)."""
        each = factor[:, None]
        return replace(self, residual=self.residual / factor, jacobian=self.jacobian / each, matrix=self.matrix / each)

    @cached_property
    def candidates(self) -> tuple[Candidate[Block], ...]:
        """The blocks, each with the indices of its columns of matrix."""
        own = consecutive(block.n_parameters for block in self.blocks)
        return tuple(Candidate(block, np.r_[span]) for block, span in zip(self.blocks, own, strict=True))

    def columns(self, blocks: Sequence[Block]) -> np.ndarray:
        """Return the indices of the given blocks' columns of matrix."""
        columns = {candidate.cause: candidate.columns for candidate in self.candidates}
        return np.concatenate([np.zeros(0, dtype=int), *(columns[block] for block in blocks)])

    def solved(self, blocks: Sequence[Block]) -> Solution:
        """Return the maximum a posteriori solution, within the bounds, with the given blocks in the model.

        The blocks' priors are on their likeliest scales (see `prior_scale`).
        """
        solution = self._on_scales(blocks, (1.0,) * len(blocks))
        for _ in range(SCALINGS):
            if (likeliest := self._likeliest_scales(solution, blocks)) == solution.scales:
                break
            solution = self._on_scales(blocks, likeliest)
        return solution

    def _likeliest_scales(self, solution: Solution, blocks: Sequence[Block]) -> tuple[float, ...]:
        spans = consecutive([len(self.prior_sd), *(block.n_parameters for block in blocks)])[1:]
        estimate, covariance, sd = solution.estimate, solution.covariance, solution.prior_sd
        return tuple(
            on_likeliest_scale(estimate[own], covariance[own, own], (0 * sd[own], sd[own]), scale)[0]
            for own, scale in zip(spans, solution.scales, strict=True)
        )

    def _on_scales(self, blocks: Sequence[Block], scales: tuple[float, ...]) -> Solution:
        """Return the solution with the blocks' priors on these scales."""
        wider = (scale * block.sd for block, scale in zip(blocks, scales, strict=True))
        sd = np.concatenate([self.prior_sd, *wider])
        free = np.full((2, len(self.prior_sd)), [[-np.inf], [np.inf]])
        bounds = np.hstack([free, *(block.bounds for block in blocks)])
        design = np.hstack([self.jacobian, self.matrix[:, self.columns(blocks)]])
        level = 1.0 if self.noise_known else float(np.sqrt(np.mean(self.residual**2)))
        independent = self._iterated(self.residual, design, sd, bounds, level, self.noise_known)
        if self.order is None:
            return replace(independent, scales=scales)
        free = ~independent.at_bound
        scaled = (design * sd)[:, free]
        # Priors are as wide as the sizes by least squares: a size beyond its prior is no sign of correlated errors.
        wide = np.maximum(1.0, np.abs(np.linalg.lstsq(scaled, self.residual)[0]))
        likelihood = RestrictedLikelihood(
            residual=independent.residual * independent.level,
            design=scaled * wide,
            pull=(independent.estimate / sd)[free] / wide,
            level=independent.level,
            degrees_of_freedom=max(1.0, len(self.residual) - independent.effective_parameters),
        )
        errors = likelihood.likeliest(self.order)
        if errors is None:
            return replace(independent, scales=scales, likelihood=likelihood)
        both = errors.whitened(np.column_stack([self.residual, design]))
        serial = self._iterated(both[:, 0], both[:, 1:], sd, bounds, float(np.sqrt(likelihood.variance(errors))), False)
        return replace(serial, scales=scales, likelihood=likelihood, errors=errors)

    def _iterated(
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
    """A solved problem: parameters (n_parameters,), the fitted ones first, then the blocks'; residual (n,) and design over level.

    level is the noise in units of sigma; at_bound (n_parameters,) marks parameters at a bound; scales are those of the blocks'
    priors, over their usual sizes. errors is the correlation model that whitens residual and design, None for independent errors;
    likelihood is the restricted likelihood that estimated it.
    """

    level: float
    estimate: np.ndarray
    prior_sd: np.ndarray
    at_bound: np.ndarray
    residual: np.ndarray
    design: np.ndarray
    scales: tuple[float, ...] = ()
    likelihood: RestrictedLikelihood | None = None
    errors: LikelyErrors | None = None

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, priors included, zero for one at a bound, (n_parameters, n_parameters)."""
        free = np.flatnonzero(~self.at_bound)
        scaled, whole = (self.design * self.prior_sd)[:, free], np.zeros(2 * self.prior_sd.shape)
        inverse = np.linalg.inv(scaled.T @ scaled + np.eye(len(free)))
        whole[np.ix_(free, free)] = inverse * np.outer(self.prior_sd[free], self.prior_sd[free])
        return whole

    @cached_property
    def effective_parameters(self) -> float:
        """Effective number of parameters, which the data rather than the priors determine."""
        shares = self.covariance.diagonal() / self.prior_sd**2
        return float((1 - shares)[~self.at_bound].sum())

    @property
    def excess(self) -> np.ndarray:
        """Sizes of the residuals (n,) over the limit of normal errors of the others' median size (1 %, over all rows)."""
        n, leverage = len(self.residual), np.vecdot(self.design @ self.covariance, self.design)
        size = np.abs(self.residual) / np.sqrt(np.maximum(1 - leverage, 0.05))
        freedom = max(1.0, MEDIAN_EFFICIENCY * (n - self.effective_parameters))
        usual = np.median(size) / scipy.stats.norm.ppf(0.75)
        return np.asarray(size / usual / scipy.stats.t.isf(APART / 2 / n, freedom))

    def narrowed(self, columns: np.ndarray) -> float:
        """Return the log determinant of some parameters' covariance in units of their priors, without those at a bound."""
        free = columns[~self.at_bound[columns]]
        scale = np.outer(self.prior_sd[free], self.prior_sd[free])
        return float(np.linalg.slogdet(self.covariance[np.ix_(free, free)] / scale)[1])

    @property
    def misfit(self) -> float:
        """Sum of squared residuals and of squared deviations from the priors."""
        return float(self.residual @ self.residual + ((self.estimate / self.prior_sd) ** 2).sum())


def _level(solution: Solution, known: bool) -> float:
    """Return the noise level by the residuals, over sigma; 1 if the noise is known and there is no significant lack of fit."""
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
    """A trial model of the stepwise search: the problem with some blocks in the model.

    rng: random numbers of the bootstrap that estimates the effective number of tests.
    """

    problem: LinearProblem
    rng: np.random.Generator
    blocks: tuple[Block, ...] = ()

    @property
    def causes(self) -> tuple[Block, ...]:
        """The blocks in the model."""
        return self.blocks

    @cached_property
    def solution(self) -> Solution:
        """The solution with these blocks in the model."""
        return self.problem.solved(self.blocks)

    def with_causes(self, causes: Sequence[Block], added: Score[Block] | None = None) -> LinearTrial:
        """Return the trial with these blocks instead."""
        return replace(self, blocks=tuple(causes))

    @cached_property
    def cost(self) -> float:
        """Cost for comparing trials, twice the negative log evidence: misfit, and penalties for parameters and variants."""
        solution, spans = self.solution, self._columns
        every = [
            (*self._amplitudes(block, columns), scale)
            for block, columns, scale in zip(self.blocks, spans, solution.scales, strict=True)
        ]
        narrowed = solution.narrowed(np.concatenate([[], *spans]).astype(int))
        cost = refitted_cost(solution.misfit, solution.level, self.first.degrees_of_freedom, every, narrowed)
        return cost + self._cost_of_errors

    @cached_property
    def findings(self) -> tuple[Detection[Block], ...]:
        """Its blocks, each with the scores of all in its place, and the correction for their number by which it was added.

        The first screening's correction is too strict beside others: their share of the residual counts as uneven noise there.
        """
        linear, family = self.linearisation, self.first.family
        return tuple(
            finding
            if len(self.blocks) == 1 or not finding.is_shown or finding.p < CLEAR * FALSE_ALARM
            else replace(finding, family=linear.apart([finding.cause]).family(self.rng))
            for finding in (linear.finding(block, family) for block in self.blocks)
        )

    @property
    def _cost_of_errors(self) -> float:
        """Further cost of correlated errors: their log determinant and parameters, and the change of posterior volume."""
        solution, fitted = self.solution, len(self.problem.prior_sd)
        if solution.errors is None:
            return 0.0
        volumes = []
        for design in (self.problem.jacobian, solution.design[:, :fitted] * solution.level):
            scaled = design * self.problem.prior_sd
            volumes.append(np.linalg.slogdet(scaled.T @ scaled + solution.level**2 * np.eye(fitted))[1])
        return float(solution.errors.log_determinant + solution.errors.narrowed + volumes[1] - volumes[0])

    def _amplitudes(self, block: Block, columns: np.ndarray) -> tuple[np.ndarray, int]:
        solution, variants = self.solution, sum(block.name == other.name for other in self.problem.blocks)
        sizes = solution.estimate[columns] / solution.prior_sd[columns]
        return np.where(solution.at_bound[columns], np.nan, sizes), variants

    @cached_property
    def linearisation(self) -> Linearisation[Block]:
        """The solution with the regressors of all blocks, including those in the model."""
        solution, problem = self.solution, self.problem
        errors = solution.errors
        shown = problem.matrix if errors is None else errors.whitened(problem.matrix)
        free = np.flatnonzero(~solution.at_bound)
        precision = solution.prior_sd**-2.0
        # What is left of a stated noise may be a block far larger than usual, beside whose own size the usual one is not seen.
        wider = solution.level if problem.noise_known else 1.0
        regressors = Regressors(
            residual=solution.residual,
            jacobian=solution.design[:, free],
            precision=precision[free],
            pull=(precision * solution.estimate)[free],
            prior_rss=float(precision @ solution.estimate**2),
            matrix=TallMatrix.held(shown / solution.level),
            prior_sd=wider * np.concatenate([block.sd for block in problem.blocks]),
            candidates=problem.candidates,
            amplitude_freedom=None
            if errors is None
            else errors.degrees_of_freedom(problem.jacobian * problem.prior_sd, problem.matrix),
        )
        columns = tuple(np.flatnonzero(np.isin(free, span)) for span in self._columns)
        return Linearisation(self.blocks, regressors, solution.estimate[free], columns)

    @property
    def _columns(self) -> list[np.ndarray]:
        """The indices of each block's columns of the design."""
        own = consecutive([len(self.problem.prior_sd), *(block.n_parameters for block in self.blocks)])[1:]
        return [np.r_[span] for span in own]


@dataclass(frozen=True)
class LinearRival:
    """A rival explanation: block name, best variant, and cost (twice the log evidence) above the finding's, over variants."""

    name: str
    variant: str
    cost: float


@dataclass(frozen=True, eq=False)
class LinearFinding:
    """A block that the model lacks.

    estimate and sd (n_parameters,) are in the parameters' units, sd nan at a bound. p is the family-wise p-value, and probability
    that of this block as opposed to its rivals. rivals are the explanations that the data do not exclude (a cost within 10),
    closest first; the rival "unexplained" is no block but serially correlated errors.
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
    """The noise: residuals of the model with its findings.

    level is its standard deviation relative to the stated noise, or in the residuals' unit without one, estimated with
    degrees_of_freedom. share of its variance is correlated along the order, over a correlation length in the order's unit; kept is
    the factor of that correlation across a border of groups. They are 0, 0 and 1 for independent errors.
    """

    level: float
    degrees_of_freedom: float
    share: float
    length: float
    kept: float

    @staticmethod
    def of(solution: Solution) -> LinearNoise:
        """Return the noise of a solved problem."""
        errors = solution.errors
        if errors is None:
            left = len(solution.residual) - solution.effective_parameters
            return LinearNoise(solution.level, float(left), 0.0, 0.0, 1.0)
        return LinearNoise(solution.level, errors.level_degrees_of_freedom, errors.share, errors.length, errors.kept)


@dataclass(frozen=True)
class LinearAdequacy:
    """Tests of the adequacy of the model with its findings.

    lack_of_fit is the p-value of the residuals' chi² under the stated noise, taken to be independent; None without a stated noise,
    where lack of fit cannot be distinguished from noise. together is the p-value of the lag-1 autocorrelation of the residuals,
    whitened by the estimated correlation. apart are the rows, from 0, whose residuals are too large for normal errors of the
    others' median size, and which were down-weighted: outliers, or noise that differs from row to row.
    """

    lack_of_fit: float | None
    together: float
    apart: tuple[int, ...]

    @staticmethod
    def of(solution: Solution, independent: Solution, noise_known: bool, apart: np.ndarray) -> LinearAdequacy:
        """Return the tests of a solved problem, given also its solution with independent errors, and the rows that lie apart."""
        residual = solution.residual
        alike = float(residual[1:] @ residual[:-1] / (residual @ residual)) * np.sqrt(len(residual))
        left = float((independent.residual**2).sum()) * independent.level**2
        freedom = max(1.0, len(residual) - independent.effective_parameters)
        p = float(scipy.stats.chi2.sf(left, freedom)) if noise_known else None
        return LinearAdequacy(p, float(2 * scipy.stats.norm.sf(abs(alike))), tuple(sorted(apart.tolist())))

    @property
    def statement(self) -> str:
        """The results in words."""
        if self.lack_of_fit is None:
            words = "Whether the model lacks something cannot be told: the noise is not known."
        else:
            much = "no more" if self.lack_of_fit > LACK_OF_FIT else "more"
            words = f"What is left is {much} than the noise (p = {self.lack_of_fit:.2g})."
        if self.together < LACK_OF_FIT:
            words += f" It is correlated from row to row beyond what the noise explains (p = {self.together:.2g})."
        if self.apart:
            listed = ", ".join(map(str, self.apart[:MOST_TOLD])) + (", ..." if len(self.apart) > MOST_TOLD else "")
            words += f" Rows too far off for normal noise, which count for less: {listed} (from 0)."
        return words


@dataclass(frozen=True)
class LinearDiagnosis:
    """The diagnosis: findings in the order of the search, and the names of blocks that these data cannot show in any variant.

    noise describes the residuals, and adequacy tests them against the stated noise.
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
    """Return the blocks that explain the residuals of a linear, or linearised, model, with their certainty and rivals.

    Residuals are predictions minus measurements (or the reverse, with matrices of the same sign), at the prior means of the
    fitted parameters, or at any estimate if there are no priors: those parameters are fitted again.

    Args:
        residual: (n,), in any unit.
        jacobian: its Jacobian by the parameters that are fitted in any case, shape (n, n_fitted).
        candidates: the blocks that the model may lack, in all variants; see `Block`.
        rng: random numbers of the bootstrap that estimates the effective number of tests.
        prior_sd: prior standard deviations (n_fitted,) of the fitted parameters about the means; None: flat priors.
        noise: standard deviation of the residuals, (n,) or a scalar, in their unit; None: unknown and the same for all. If a
            lack of fit is significant (1 %), the noise is scaled to the residuals.
        order: (n,) coordinates of the rows, a time say, along which errors may be serially correlated. None: the order of
            rows, with those of a group together.
        groups: (n,) numbers or names, equal for rows that may share an error, which then counts once. None: no groups.
        false_alarm: family-wise false-alarm rate: chance of any finding where nothing is hidden.
        most: largest number of findings.

    Raises:
        InputError: shapes that do not match, or figures that are not finite or not admissible, all in one message.
    """
    named = {"residual": residual, "jacobian": jacobian, "prior_sd": prior_sd, "noise": noise, "order": order}
    numbers = (partial(_numbers, name, figures) for name, figures in named.items())
    candidates, residual, jacobian, prior_sd, noise, order = run_checks(partial(_blocks, candidates), *numbers)
    groups = None if groups is None else np.asarray(groups)
    refuse_any(map(Problem, _problems(residual, jacobian, candidates, prior_sd, noise, order, groups)))
    sigma = np.broadcast_to(1.0 if noise is None else noise, residual.shape)
    whitened, design = residual / sigma, jacobian / sigma[:, None]
    matrix = np.hstack([block.matrix for block in candidates]) / sigma[:, None]
    prior = _flat(whitened, design) if prior_sd is None else prior_sd
    shared = None if groups is None else pd.factorize(groups)[0]  # in order of appearance
    rows, row_order = RowOrder.sorted(len(residual), order, shared)
    problem = LinearProblem(
        whitened[rows], design[rows], prior, tuple(candidates), matrix[rows], noise is not None, row_order
    )
    acceptance, factor = CauseAcceptance(false_alarm, most), np.ones(len(rows))
    search = _searched(problem, acceptance, rng)
    for _ in range(WEIGHINGS):
        more = np.maximum(1.0, search.best.solution.excess) ** 2
        if more.max() < SETTLED:
            break
        problem, factor = problem.weighed(more), factor * more
        search = _searched(problem, acceptance, rng)
    unnamed = _serial_costs(search.best)
    detections = [replace(detection, unnamed=unnamed[detection.cause]) for detection in search.best.findings]
    return LinearDiagnosis(
        tuple(map(_finding, detections)),
        tuple(dict.fromkeys(block.name for block in candidates if block.name not in _visible(search.best))),
        LinearNoise.of(search.best.solution),
        LinearAdequacy.of(
            search.best.solution,
            replace(problem, order=None).solved(search.best.blocks),
            problem.noise_known,
            rows[factor > 1],
        ),
    )


def _visible(trial: Trial[Block]) -> set[str]:
    """Return the names of blocks that are identifiable beside the fitted parameters."""
    linear = trial.linearisation
    return {score.cause.name for score in (linear.apart(trial.causes) if trial.causes else linear.beside).scores}


@dataclass(frozen=True)
class Search:
    """A stepwise search: its initial model, and the best model."""

    start: LinearTrial
    best: LinearTrial

    @staticmethod
    def of(problem: LinearProblem, acceptance: CauseAcceptance, rng: np.random.Generator, *blocks: Block) -> Search:
        """Return the search from the empty model, and from one with the given blocks if there are any."""
        bare = LinearTrial(Screened((), Family({}, 1.0), len(problem.residual)), problem, rng)
        start = replace(bare, first=bare.linearisation.screened(rng))
        further = [start.with_causes(blocks)] if blocks else []
        best = Stepwise(acceptance, rng, nobody, nobody).best(start, *further)
        return Search(start, start.with_causes(best.causes))


def _searched(problem: LinearProblem, acceptance: CauseAcceptance, rng: np.random.Generator) -> Search:
    """Search with serially correlated errors, from the empty model and from the result with independent errors.

    A smooth cause and correlated errors are mistaken for each other until both are in the model, hence the two starts. A block
    must explain the data clearly better than correlated errors in its place.
    """
    independent = Search.of(replace(problem, order=None), acceptance, rng)
    start = replace(independent.start, problem=problem)
    serial = start.with_causes(independent.best.causes)
    if start.solution.errors is None and serial.solution.errors is None:
        return independent
    ended = [Search.of(problem, acceptance, rng)]
    if serial.blocks:
        ended.append(Search.of(problem, acceptance, rng, *serial.blocks))
    best = min(ended, key=lambda search: search.best.cost + SPLIT * len(search.best.causes))
    while losing := {cause: cost for cause, cost in _serial_costs(best.best).items() if cost < SPLIT}:
        weakest = min(losing, key=lambda cause: losing[cause])
        best = replace(best, best=best.best.with_causes([cause for cause in best.best.causes if cause is not weakest]))
    return best


def _serial_costs(trial: LinearTrial) -> dict[Block, float]:
    """Return, for each block, the cost of correlated errors in its place above its own; infinite without correlation."""
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
    estimate, covariance = score.likeliest
    sd = np.where(held, np.nan, np.sqrt(np.diag(covariance)))
    cause = finding.cause
    return LinearFinding(cause.name, cause.variant, estimate, sd, finding.p, named.probability, rivals)


def _flat(residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return standard deviations (n_fitted,) of nearly flat priors, which only keep undetermined parameters finite."""
    length = np.linalg.norm(jacobian, axis=0)
    return np.asarray(UNRESTRICTED * np.linalg.norm(residual) / np.where(length > 0, length, 1.0))


def _numbers(name: str, figures: np.ndarray | float | None) -> np.ndarray | None:
    """Return an argument as real numbers, None if it is not given."""
    if figures is None:
        return None
    try:
        if not np.iscomplexobj(figures):
            return np.asarray(figures, dtype=float)
    except (TypeError, ValueError):
        pass
    raise refuse(f"{name}: expected an array of real numbers")


def _blocks(candidates: Sequence[Block]) -> tuple[Block, ...]:
    """Return the candidates, whose names and variants are theirs alone."""
    every = () if isinstance(candidates, Block) else tuple(candidates)
    if isinstance(candidates, Block) or not all(isinstance(block, Block) for block in every):
        raise refuse("candidates: expected a list of blocks, calflow.linear.Block(name, matrix, prior_sd)")
    count = Counter((block.name, block.variant) for block in every)
    refuse_any(
        Problem(
            f"candidate {' '.join(filter(None, key))}: is given {times} times, expected variants of different names"
        )
        for key, times in count.items()
        if times > 1
    )
    return every


def _problems(
    residual: np.ndarray, jacobian: np.ndarray, candidates: Sequence[Block], prior_sd: np.ndarray | None,
    noise: np.ndarray | float | None, order: np.ndarray | None, groups: np.ndarray | None,
) -> list[str]:  # fmt: skip
    """Return all problems with the arguments."""
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
        elif figures is not None and not (np.isfinite(figures) if name == "order" else ~pd.isna(figures)).all():
            problems.append(f"{name}: has figures that are not finite")
    if not candidates:
        problems.append("candidates: expected at least one block")
    for block in candidates:
        problems += [f"candidate {' '.join(filter(None, (block.name, block.variant)))}: {m}" for m in _flaws(block, n)]
    return problems


def _flaws(block: Block, n: int) -> list[str]:
    """Return all problems with a block, given the number of residuals."""
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
