"""The error model: errors of a calibrated model beyond the device's noise.

Residuals are white noise plus random smooth functions of joints, place, payload and time, with variances by the data (see
`variance_components`). The parameters' covariance is that of generalised least squares with them (Aitken 1936), so that a smooth
misfit does not count as many independent errors, nor its extrapolation as certain. A prediction's error is that of parameters and
functions, given the data: small between measured poses, with the prior variance far from them (see `extrapolation`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain

import numpy as np
import scipy

from calflow.effects.base import Effect
from calflow.estimation.fit import Fit
from calflow.estimation.forward_substitution import forward
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import PerUnit, representative
from calflow.estimation.probing import Probe
from calflow.estimation.smooth_functions import Part, SmoothFunction, is_mean, means, smooth_functions
from calflow.estimation.variance_components import NormalEquations, VarianceComponents
from calflow.files.deferred import pd
from calflow.files.problems import refuse
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model

MIN_REDUCTION = 1e-2  # least relative reduction of a direction's variance by the data for it to be kept
VISIBLE = 0.05  # least variance of a part over the white noise's: no noise is stated more accurately
INSIDE = 1e-9  # share of the distance to a bound that a step leaves


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The posterior of random smooth functions beside a model.

    sd (n_functions,) [m, rad or 1]: prior standard deviations of the amplitudes. For amplitudes over sd, given the parameters:
    mean (n_functions,): posterior means at the generalised estimate; slope (n_functions, n_parameters): minus their derivatives by
    the parameters; told (n_functions, n_directions): root of the reduction of their covariance, which is I - told toldᵀ. offset
    (n_parameters,): generalised less ordinary least-squares estimate; rest: standard deviation of the white part of errors per
    axis, without the device's noise where that is known.
    """

    functions: tuple[SmoothFunction, ...]
    sd: np.ndarray
    mean: np.ndarray
    slope: np.ndarray
    told: np.ndarray
    offset: np.ndarray
    rest: PerUnit

    @staticmethod
    def white(rest: PerUnit, n_parameters: int) -> ErrorModel:
        none = np.zeros(0)
        return ErrorModel((), none, none, np.zeros((0, n_parameters)), np.zeros((0, 0)), np.zeros(n_parameters), rest)

    def only(self, keep: Callable[[SmoothFunction], bool]) -> ErrorModel:
        """Return a copy with some functions alone."""
        kept = self._of(keep)
        return replace(
            self,
            functions=tuple(filter(keep, self.functions)),
            sd=self.sd[kept],
            mean=self.mean[kept],
            slope=self.slope[kept],
            told=self.told[kept],
        )

    def with_functions(
        self, functions: Sequence[SmoothFunction], sd: np.ndarray, known: tuple[np.ndarray, np.ndarray] | None = None
    ) -> ErrorModel:
        """Return a copy with further functions of standard deviations sd (n,); known is, if given, their exact mean and slope."""
        mean, slope = known or (np.zeros(len(sd)), np.zeros((len(sd), self.slope.shape[1])))
        n_known = len(sd) if known else 0
        return replace(
            self,
            functions=(*self.functions, *functions),
            sd=np.append(self.sd, sd),
            mean=np.append(self.mean, mean),
            slope=np.vstack([self.slope, slope]),
            told=scipy.linalg.block_diag(self.told, np.eye(len(sd), n_known)),
        )

    @cached_property
    def spread(self) -> np.ndarray:
        """A root (n_functions, n_functions) of the amplitudes' covariance given the parameters."""
        return root_of(np.eye(len(self.sd)) - self.told @ self.told.T)

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for function in self.functions for name in function.inputs))

    def _of(self, keep: Callable[[SmoothFunction], bool]) -> np.ndarray:
        return np.array([keep(function) for function in self.functions for _ in function.declared], dtype=bool)

    def shared(self, slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return errors as factors (n_rows, n_axes, n) of independent standard normals, by their slopes (n_rows, n_axes, n_all).

        Their squares add up to the mean square error of the model without these functions, so that their posterior mean counts in
        full, but for the part that is independent from row to row. covariance is of the parameters, with their offset.
        """
        # One product of matrices: a stack of small ones takes several times as long.
        alone = np.tensordot(slopes[:, :, slopes.shape[2] - len(self.sd) :], self.spread, 1)
        return np.concatenate([np.tensordot(slopes, self.root(self.about_mean(covariance)), 1), alone], axis=2)

    def slopes(
        self, model: Model, estimate: np.ndarray, conditions: np.ndarray, places: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the derivatives of positions (see `Model.point`) by parameters and amplitudes over sd, (n_rows, 3, n) [m]."""
        by_parameters = model.point_jacobian(estimate, conditions, places)
        return np.concatenate([by_parameters, self.moved(model, estimate, conditions)], axis=2)

    def slopes_of(
        self, jacobian: Callable[[Model, np.ndarray], np.ndarray], model: Model, estimate: np.ndarray
    ) -> np.ndarray:
        """Return those of anything else (n_rows, n_axes, n), given its Jacobian by the parameters of a model at an estimate."""
        slopes = jacobian(*_with(model, self.functions, estimate))
        return slopes * np.append(np.ones(slopes.shape[-1] - len(self.sd)), self.sd)

    def moved(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the change of rows' reported positions by each amplitude at one sd, (n_rows, 3, n_functions) [m]."""
        moved = np.zeros((conditions.shape[1], 3, len(self.sd)))
        in_space = tuple(function for function in self.functions if not function.of_images)
        if in_space:
            beside, at = _with(model, in_space, estimate)
            moved[:, :, self._of(in_space.__contains__)] = beside.position_jacobian(at, conditions)[
                :, :, len(estimate) :
            ]
        return moved * self.sd

    def about_mean(self, covariance: np.ndarray) -> np.ndarray:
        """Return the covariance of the parameters about the generalised estimate, given that which includes their offset."""
        return np.asarray(covariance - np.outer(self.offset, self.offset))

    def root(self, covariance: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Return the joint errors of parameters and of the amplitudes that follow them, as factors of independent standard normals.

        Shape (n_parameters + n_functions, 1 + n_parameters); the first column is their mean. `spread` is to be added. covariance is
        of the parameters about their mean; change (n_parameters,): that less the estimate, by default the offset.
        """
        change = self.offset if change is None else change
        own = root_of(covariance)
        mean = np.append(change, self.mean + self.slope @ (self.offset - change))
        return np.column_stack([mean, np.vstack([own, -self.slope @ own])])


def root_of(covariance: np.ndarray) -> np.ndarray:
    """Return a root R (n, n) of a covariance R Rᵀ that is positive semidefinite but for rounding."""
    sd = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    # A torque in Nm beside a compliance in rad/Nm: by the largest of both, the smallest would be lost in rounding.
    scale = np.where(sd > 0, sd, 1.0)
    value, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(value, 0.0)))


def of_parameters(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variances (n_rows, 3) of J Σ Jᵀ, with a Jacobian J (n_rows, 3, n_parameters)."""
    return np.asarray(np.einsum("nai,ij,naj->na", jacobian, covariance, jacobian, optimize=True))


@dataclass(frozen=True, kw_only=True)
class SmoothAmplitude:
    """An amplitude of a smooth error of the model, without physical meaning."""

    function: int = column(
        "number of its function; 0: the row holds the offset of the generalised estimate in place of slopes, and the standard "
        "deviation of the white part of errors in a unit in place of sd"
    )
    kind: str = column("kind of the function; where its number is 0, that unit: mm, mrad, px, …")
    figures: str = column("the function's figures as JSON, in the row of its first amplitude")
    sd: float = column("prior standard deviation [m, rad or 1]; where the function's number is 0, in the SI unit")
    mean: float = column("posterior mean, over sd")
    slope: Mapping[str, float] = column(
        "minus the derivative of the mean by a parameter [over its SI unit]", name="slope {parameter}"
    )
    told: Mapping[str, float] = column(
        "column of a root of the covariance's reduction by the data, given the parameters: I - told toldᵀ is the covariance",
        name="told {n}",
    )


def error_table(errors: ErrorModel, model: Model) -> pd.DataFrame:
    """Return the table of `SmoothAmplitude`s."""
    told = [f"told {n + 1}" for n in range(errors.told.shape[1])]
    slopes = [f"slope {parameter.name}" for parameter in model.parameters]
    first = [np.concatenate([[size, 0.0], errors.offset, np.zeros(len(told))]) for _, size in errors.rest.sizes]
    others = np.column_stack([errors.sd, errors.mean, errors.slope, errors.told])
    rows = [(0, unit.label, "") for unit, _ in errors.rest.sizes]
    for number, function in enumerate(errors.functions, start=1):
        kind, figures = type(function).__name__, function.figures_text
        rows += [(number, kind, "" if k else figures) for k in range(len(function.declared))]
    named = pd.DataFrame(rows, columns=["function", "kind", "figures"])
    numbers = pd.DataFrame(np.vstack([*first, others]), columns=["sd", "mean", *slopes, *told])
    return typed(pd.concat([named, numbers], axis=1), SmoothAmplitude)


def read_errors(table: pd.DataFrame, model: Model, kinds: Mapping[str, type[SmoothFunction]]) -> ErrorModel:
    """Return the error model of an `error_table`, with functions of these kinds by name.

    Raises:
        InputError: another version of calflow made the table, with functions of other kinds.
    """
    beside, table = table[table["function"] == 0], table[table["function"] > 0]
    if unknown := set(table["kind"]) - set(kinds):
        raise refuse(
            f"has smooth errors of another version of calflow ({', '.join(sorted(unknown))}); run the study again"
        )
    functions = [
        kinds[kind].of_figures(model.robot, figures)
        for kind, figures in table.drop_duplicates("function")[["kind", "figures"]].to_numpy(dtype=str)
    ]
    columns = [[name for name in map(str, table) if name.startswith(word)] for word in ("slope ", "told ")]
    every = (table[name].to_numpy(dtype=float) for name in ("sd", "mean", *columns))
    sd, mean, slope, told = map(np.ascontiguousarray, every)  # the layout decides the last bit of sums
    units = {unit.label: unit for observation in model.observations for unit in observation.units}
    rest = PerUnit(tuple((units[label], float(size)) for label, size in beside[["kind", "sd"]].to_numpy()))
    offset = beside[columns[0]].iloc[0].to_numpy(dtype=float)
    return ErrorModel(tuple(functions), sd, mean, slope, told, offset, rest)


def _with(model: Model, functions: tuple[SmoothFunction, ...], estimate: np.ndarray) -> tuple[Model, np.ndarray]:
    beside = _beside(model, functions)
    return beside, np.append(estimate, beside.nominal[len(estimate) :])


@lru_cache(maxsize=8)
def _beside(model: Model, functions: tuple[SmoothFunction, ...]) -> Model:
    """Return a model with functions beside it; cached, since its derivatives take longer to build than to evaluate."""
    return replace(model, probes=functions)


def beside_smooth_errors(sizes: SmoothVariances, variance: np.ndarray, elsewhere: PerUnit) -> tuple[Fit, ErrorModel]:
    """Return a fit with the information that remains beside smooth errors of variances (n_parts,), and the error model.

    The estimate stays that of ordinary least squares: without the functions' means, which are not the robot's alone, it predicts
    poses like those fitted better than that of generalised least squares, and the distance of the two counts as an error.
    elsewhere is the excess of leave-one-pose-out errors over noise and parameters, per axis, used where nothing smooth shows.
    """
    result, problem = sizes.result, sizes.result.problem
    model, estimate = result.model, result.estimate
    active = sizes.active(variance)
    functions = tuple(dict.fromkeys(sizes.of_amplitude[number][1] for number in active))
    # Without functions the noise's level is the fit's own, which includes the discrepancy.
    level = sizes.components.level(variance) if functions else 1.0
    left = {
        unit: level * problem.scatter(unit) ** 2 - sizes.known * problem.device(unit) ** 2 for unit in problem.units
    }
    excess = {unit: 0.0 if functions else elsewhere[unit] for unit in left}
    rest = PerUnit(tuple((unit, float(np.hypot(max(of, 0.0) ** 0.5, excess[unit]))) for unit, of in left.items()))
    if not functions:
        return result, ErrorModel.white(rest, len(estimate))
    n, here = len(estimate), len(active)
    equations = sizes.equations.only(np.append(np.arange(n), n + active))
    if equations.number < problem.size:
        equations = normal_equations(problem.reweighted(estimate, result.loss), estimate, functions)
    size = np.sqrt(level * variance[sizes.part[active]])
    both = equations.over(level).scaled(np.append(np.ones(n), size)).with_prior(
        np.append(estimate - model.prior_mean, np.zeros(here)), np.append(model.prior_sd**-2.0, np.ones(here))
    )  # fmt: skip
    beside = both.beside(np.arange(n, n + here))
    offset, information = _step(beside, model, estimate), beside.gram
    inverse, mixed = np.linalg.inv(both.gram[n:, n:]), both.gram[n:, :n]
    value, axes = np.linalg.eigh(np.eye(here) - inverse)
    errors = ErrorModel(
        functions,
        size * usual_sizes(model, functions),
        -inverse @ (both.score[n:] + mixed @ offset),
        inverse @ mixed,
        np.ascontiguousarray((axes * np.sqrt(np.maximum(value, 0.0)))[:, value > MIN_REDUCTION]),
        offset,
        rest,
    )
    # Inverse of the covariance plus the square of the offset (Sherman and Morrison 1950).
    along = information @ offset
    unsure = replace(result, information=information - np.outer(along, along) / (1 + along @ offset))
    return unsure, errors


def usual_sizes(model: Model, functions: Sequence[SmoothFunction]) -> np.ndarray:
    """Return the usual prior standard deviations of functions' amplitudes, shape (n_functions,)."""
    sd = replace(model, probes=tuple(functions)).prior_sd[len(model.parameters) :]
    return np.asarray(sd * np.concatenate([np.zeros(0), *(function.spectrum for function in functions)]))


@dataclass(frozen=True, eq=False)
class SmoothVariances:
    """The variances of smooth functions beside a model.

    result: the fit to rows with independent errors; data: these rows; known: whether the device's noise is known independently of
    the fit; kinds: inputs and functions of each part; equations: those of parameters and functions, of a representative subset of
    the rows. Means and slopes, which geometry imitates, are not used to estimate a part's variance.
    """

    result: Fit
    data: Measurements
    known: bool
    kinds: list[Part]
    equations: NormalEquations

    @staticmethod
    def of(result: Fit, data: Measurements, known: bool, parts: Sequence[Part] = ()) -> SmoothVariances:
        """Return the variances of parts, by default all `smooth_functions`, beside a fit linearised for a subset of its rows."""
        problem = result.problem.only(representative(data)).reweighted(result.estimate, result.loss)
        parts = parts or smooth_functions(problem, result.estimate, data)
        kinds = [(inputs, [*effects, *means(effects)]) for inputs, effects in parts]
        functions = [effect for _, effects in kinds for effect in effects]
        return SmoothVariances(result, data, known, kinds, normal_equations(problem, result.estimate, functions))

    def without(self, effects: Sequence[Effect]) -> SmoothVariances:
        """Return the variances beside the model without some effects, on which residuals depend linearly."""
        before, n = self.result.estimate, len(self.result.estimate)
        gone = np.isin(np.arange(n + len(self.part)), np.concatenate([*map(self.result.model.columns, effects)]))
        estimate = np.where(gone[:n], 0.0, before)
        equations = self.equations.about(np.append(estimate - before, np.zeros(len(self.part)))).scaled(1.0 - gone)
        return replace(self, result=replace(self.result, estimate=estimate), equations=equations)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs of the parts with non-zero variance."""
        there = (inputs for (inputs, _), variance in zip(self.kinds, self.variance, strict=True) if variance > 0)
        return tuple(dict.fromkeys(chain.from_iterable(there)))

    @cached_property
    def of_amplitude(self) -> list[tuple[int, SmoothFunction]]:
        """Index of the part, and function, of each amplitude, (n_functions,)."""
        every = ((k, effect) for k, (_, effects) in enumerate(self.kinds) for effect in effects)
        return [(k, effect) for k, effect in every for _ in effect.declared]

    @cached_property
    def part(self) -> np.ndarray:
        """Index of each amplitude's part, (n_functions,)."""
        return np.array([k for k, _ in self.of_amplitude], dtype=int)

    @cached_property
    def informative(self) -> np.ndarray:
        """Indices of the amplitudes used to estimate variances: all but means."""
        return np.flatnonzero([not is_mean(effect) for _, effect in self.of_amplitude])

    def active(self, variance: np.ndarray) -> np.ndarray:
        """Return the indices of the amplitudes with non-zero variance (n_parts,); means only of parts that are accepted."""
        here = np.where([is_mean(effect) for _, effect in self.of_amplitude], self.accepted[self.part], 1.0)
        return np.flatnonzero(variance[self.part] * here)

    @cached_property
    def components(self) -> VarianceComponents:
        """The restricted likelihood of the variances."""
        result, problem, model = self.result, self.result.problem, self.result.model
        floor = float(np.median((problem.sigma / problem.total) ** 2)) if self.known else 0.0
        n, none = len(result.estimate), np.zeros(len(self.part))
        free, smooth = np.flatnonzero(~result.at_bound), self.informative
        offset, precision = result.estimate - model.prior_mean, model.prior_sd**-2.0
        both = self.equations.with_prior(np.append(offset, none), np.append(precision, none))
        beside = both.only(np.append(free, n + smooth)).beside(np.arange(len(free)))
        freedom = self.equations.number - result.effective_parameters
        return VarianceComponents(
            self.part[smooth], len(self.kinds), beside.gram, beside.score, beside.chi2, freedom, floor
        )

    @property
    def cost(self) -> float:
        """Minus twice the log evidence of model and accepted variances, comparable with that without some effects."""
        free = np.flatnonzero(~self.result.at_bound)
        sd = self.result.model.prior_sd[free]
        told = self.equations.gram[np.ix_(free, free)] * np.outer(sd, sd) + np.eye(len(free))
        return self.components.cost(self.accepted) + float(np.linalg.slogdet(told)[1])

    @cached_property
    def accepted(self) -> np.ndarray:
        """Each part's accepted variance, zero where it is not significant, (n_parts,)."""
        return self.components.accepted()

    @cached_property
    def variance(self) -> np.ndarray:
        """Each part's posterior mean variance, over its functions' usual ones and the noise's level, (n_parts,)."""
        return self._visible(self.components.expected(self.accepted))

    def drawn(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw variances (number, n_parts) from the posterior of which `variance` is the mean."""
        return self._visible(self.components.drawn(self.accepted, number, rng))

    @property
    def probabilities(self) -> dict[tuple[str, ...], float]:
        """The posterior probabilities of smooth errors by inputs."""
        none: dict[tuple[str, ...], float] = {}
        for (inputs, _), sizes in zip(self.kinds, self.components.probabilities(self.accepted), strict=True):
            none[inputs] = none.get(inputs, 1.0) * (1 - float(sizes.sum()))
        return {inputs: 1 - absent for inputs, absent in none.items()}

    def _visible(self, variance: np.ndarray) -> np.ndarray:
        """Return variances (…, n_parts) that matter beside the noise, the others as zero."""
        shown = self.equations.gram.diagonal()[len(self.result.estimate) + self.informative]
        moved = np.bincount(self.part[self.informative], shown, len(self.kinds)) * variance
        return np.where(moved > VISIBLE * self.equations.number, variance, 0.0)


def normal_equations(
    problem: LeastSquares, estimate: np.ndarray, functions: Sequence[SmoothFunction]
) -> NormalEquations:
    """Return the normal equations of a problem linearised at an estimate: its parameters, then functions at usual sizes."""
    probe = Probe.of(problem, estimate, functions).compiled(1)
    products = np.zeros((probe.shape[1] + 1, probe.shape[1] + 1))
    for _, left, slopes in probe.parts():
        both = np.column_stack([slopes, left])
        products += both.T @ both
    usual = np.append(np.ones(len(estimate)), usual_sizes(problem.model, functions))
    return NormalEquations(products, problem.size).scaled(usual)


def _step(equations: NormalEquations, model: Model, estimate: np.ndarray) -> np.ndarray:
    """Return the step of the parameters (n,) from an estimate to the minimum of their normal equations within bounds."""
    factor = np.linalg.cholesky(equations.gram * np.outer(model.prior_sd, model.prior_sd))
    target = -forward(factor, model.prior_sd * equations.score)
    room = ((model.bounds.T - estimate) / model.prior_sd) * (1 - INSIDE)
    return np.asarray(model.prior_sd * scipy.optimize.lsq_linear(factor.T, target, room).x)
