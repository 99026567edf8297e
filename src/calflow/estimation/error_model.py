"""The error model: what a calibrated model errs by beside its device's noise.

Residuals are white noise and random smooth functions of joints, place, payload and time, each input's of the size that the data
allow (see `variance_components`). Beside them the parameters are as sure as by generalised least squares (Aitken 1936): a smooth
misfit is not taken for as many independent errors as it has rows, and what carries it elsewhere is not taken for sure.

A prediction errs by its parameters' errors and by the functions, both given the data: little between poses that were measured,
by the functions' full size far from them (at a joint past its travel, or at a later hour, see `beyond_measured`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain

import casadi as ca
import numpy as np
import scipy

from calflow.effects.base import OF_THE_FRAME, Cause, Effect
from calflow.effects.warming import Warming
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import representative
from calflow.estimation.probing import Probe
from calflow.estimation.smooth_functions import (
    WALK,
    AtAnyTime,
    BeyondTravel,
    InPlace,
    InTime,
    JointField,
    Later,
    Shift,
    SmoothFunction,
    UnderPayload,
    in_time,
    is_mean,
    means,
    smooth_functions,
)
from calflow.estimation.variance_components import SIZES, VarianceComponents
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model

TOLD = 1e-2  # of a direction's variance: what the data take away less of, they tell nothing about
ROWS = 1000  # at which the functions' slopes are there at once
VISIBLE = 0.05  # of the white noise's variance: a part that moves residuals by less is none; no noise is stated better


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Random smooth functions beside a model, as the data leave them.

    sd (n_functions,) [m, rad or 1] are their amplitudes' standard deviations before any data. Of the amplitudes over these,
    mean (n_functions,) are the estimates, slope (n_functions, n_parameters) by how much they fall as a parameter rises, told
    (n_functions, n_directions) what the data tell where the parameters are given: the covariance is I - told toldᵀ then. offset
    (n_parameters,) is by how much the parameters would move beside the functions, rest [m] what lengths err by that is not smooth,
    per axis, the device's noise not in it where that is known.
    """

    functions: tuple[SmoothFunction, ...]
    sd: np.ndarray
    mean: np.ndarray
    slope: np.ndarray
    told: np.ndarray
    offset: np.ndarray
    rest: float

    @staticmethod
    def white(rest: float, n_parameters: int) -> ErrorModel:
        """Return one without smooth errors."""
        none = np.zeros(0)
        return ErrorModel((), none, none, np.zeros((0, n_parameters)), np.zeros((0, 0)), np.zeros(n_parameters), rest)

    @property
    def function_of(self) -> tuple[SmoothFunction, ...]:
        """The function that each amplitude is of, (n_functions,)."""
        return tuple(function for function in self.functions for _ in function.declared)

    def only(self, kept: np.ndarray) -> ErrorModel:
        """Return it without some functions: kept (n_functions,) says of which amplitudes they stay."""
        functions = dict.fromkeys(function for function, here in zip(self.function_of, kept, strict=True) if here)
        return replace(
            self,
            functions=tuple(functions),
            sd=self.sd[kept],
            mean=self.mean[kept],
            slope=self.slope[kept],
            told=self.told[kept],
        )

    def with_functions(
        self, functions: Sequence[SmoothFunction], sd: np.ndarray, known: np.ndarray | None = None
    ) -> ErrorModel:
        """Return it with further functions, of sizes sd (n,), which are for certain known (n,) times these where that is given."""
        n_known = 0 if known is None else len(sd)
        told = np.zeros((len(self.sd) + len(sd), self.told.shape[1] + n_known))
        told[: len(self.sd), : self.told.shape[1]] = self.told
        told[len(self.sd) :, self.told.shape[1] :] = np.eye(len(sd), n_known)
        return replace(
            self,
            functions=(*self.functions, *functions),
            sd=np.append(self.sd, sd),
            mean=np.append(self.mean, np.zeros(len(sd)) if known is None else known),
            slope=np.vstack([self.slope, np.zeros((len(sd), self.slope.shape[1]))]),
            told=told,
        )

    @cached_property
    def spread(self) -> np.ndarray:
        """A root (n_functions, n_functions) of the amplitudes' covariance where the parameters are given."""
        value, axes = np.linalg.eigh(np.eye(len(self.sd)) - self.told @ self.told.T)
        return np.asarray(axes * np.sqrt(np.maximum(value, 0.0)))

    @property
    def inputs(self) -> tuple[str, ...]:
        """What the functions depend on."""
        return tuple(dict.fromkeys(name for function in self.functions for name in function.inputs))

    def variance(
        self, model: Model, estimate: np.ndarray, covariance: np.ndarray, conditions: np.ndarray
    ) -> np.ndarray:
        """Return the variance of rows' positions per axis, that of the parameters in it, shape (n_rows, 3) [m²].

        It is the mean square by which the model without these functions errs, so that what is known of them counts whole.
        """
        parts = np.array_split(conditions, range(ROWS, conditions.shape[1], ROWS), axis=1)  # not too many rows at once
        jacobians = (model.point_jacobian(estimate, part) for part in parts)
        at_rows = (self.at(model, estimate, part) for part in parts)
        return np.concatenate(
            [at.variance(jacobian, covariance) for at, jacobian in zip(at_rows, jacobians, strict=True)]
        )

    def at(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> ErrorsAtRows:
        """Return what positions of rows err by."""
        return ErrorsAtRows(self, self._moved(model, estimate, conditions))

    def _moved(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """What each function of its usual size does to reported positions, shape (n_rows, 3, n_functions) [m]."""
        if not self.functions:
            return np.zeros((conditions.shape[1], 3, 0))
        beside, n = _with(model, self.functions), len(estimate)
        at = np.append(estimate, beside.nominal[n:])
        return np.asarray(beside.position_jacobian(at, conditions)[:, :, n:] * self.sd)


@dataclass(frozen=True, eq=False)
class ErrorsAtRows:
    """What positions of some rows err by beside the parameters' errors.

    moved (n_rows, 3, n_functions) [m] is what a function of its size does.
    """

    of: ErrorModel
    moved: np.ndarray

    @property
    def unsure(self) -> np.ndarray:
        """The variance of the errors where the parameters are given, shape (n_rows, 3) [m²]."""
        smooth = (self.moved**2).sum(axis=2) - ((self.moved @ self.of.told) ** 2).sum(axis=2)
        return np.asarray(self.of.rest**2 + np.maximum(smooth, 0.0))

    def slopes(self, jacobian: np.ndarray) -> np.ndarray:
        """Return the derivatives of the positions by the parameters (n_rows, 3, n_parameters), smooth errors following these."""
        return np.asarray(jacobian - self.moved @ self.of.slope)

    def variance(self, jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return the mean square of the errors (n_rows, 3) [m²], the parameters' in it.

        Args:
            jacobian: of the positions by the parameters, (n_rows, 3, n_parameters).
            covariance: of the parameters, their offset in it.
        """
        slopes, offset = self.slopes(jacobian), self.of.offset
        alone = np.maximum(of_parameters(slopes, covariance) - (slopes @ offset) ** 2, 0.0)
        return np.asarray(self.unsure + alone + self.expected(jacobian, offset) ** 2)

    def shared(self, jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return what each of independent standard normals does to the positions (n_rows, 3, n) [m], for the same arguments.

        Their squares add up to the variance but for what each row errs by for itself.
        """
        offset = self.of.offset
        off = self.expected(jacobian, offset)
        return np.concatenate(
            [self.scattered(jacobian, covariance - np.outer(offset, offset)), off[:, :, None]], axis=2
        )

    def expected(self, jacobian: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return by how much positions err on average (n_rows, 3) [m] where the parameters are a change (n,) from the estimate."""
        return np.asarray(self.slopes(jacobian) @ change + self.moved @ (self.of.slope @ self.of.offset + self.of.mean))

    def scattered(self, jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return what each of independent standard normals does to positions (n_rows, 3, n) [m] about what is expected.

        covariance is the parameters' about their own expectation, their offset not in it.
        """
        value, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(value, 0.0))
        return np.concatenate([self.slopes(jacobian) @ root, self.moved @ self.of.spread], axis=2)


def of_parameters(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance (n_rows, 3) of what depends on the parameters by a Jacobian (n_rows, 3, n_parameters)."""
    return np.asarray(np.einsum("nai,ij,naj->na", jacobian, covariance, jacobian, optimize=True))


@dataclass(frozen=True, kw_only=True)
class SmoothAmplitude:
    """An amplitude of a smooth error that the model leaves, of no physical meaning."""

    function: int = column(
        "number of the function that it is of; 0: by how much the parameters would move beside all of them, in place of slopes, "
        "and what lengths err by that is not smooth, in place of sd"
    )
    kind: str = column("what kind of function that is")
    figures: str = column("the figures that make it, as JSON, where its amplitudes begin")
    sd: float = column("standard deviation before any data [m, rad or 1]")
    mean: float = column("estimate, over sd")
    slope: Mapping[str, float] = column(
        "by how much the estimate falls as a parameter rises [over its SI unit]", name="slope {parameter}"
    )
    told: Mapping[str, float] = column(
        "along a direction that the data tell where parameters are given: I - told toldᵀ is the covariance",
        name="told {n}",
    )


def error_table(errors: ErrorModel, model: Model) -> pd.DataFrame:
    """Return the table of `SmoothAmplitude`s."""
    told = [f"told {n + 1}" for n in range(errors.told.shape[1])]
    slopes = [f"slope {parameter.name}" for parameter in model.parameters]
    amplitudes = [(k, function, n == 0) for k, function in enumerate(errors.functions, start=1)
                  for n in range(len(function.declared))]  # fmt: skip
    first = np.concatenate([[errors.rest, 0.0], errors.offset, np.zeros(len(told))])
    others = np.column_stack([errors.sd, errors.mean, errors.slope, errors.told])
    named = pd.DataFrame(
        {
            "function": [0, *(number for number, *_ in amplitudes)],
            "kind": ["", *(type(function).__name__ for _, function, _ in amplitudes)],
            "figures": ["", *(function.figures_text if first else "" for _, function, first in amplitudes)],
        }
    )
    numbers = pd.DataFrame(np.vstack([first, others]), columns=["sd", "mean", *slopes, *told])
    return typed(pd.concat([named, numbers], axis=1), SmoothAmplitude)


def read_errors(table: pd.DataFrame, model: Model) -> ErrorModel:
    """Rebuild what `error_table` wrote."""
    offset, table = table.iloc[0], table.iloc[1:]
    kinds: dict[str, type[SmoothFunction]] = {
        kind.__name__: kind
        for kind in (JointField, Shift, InTime, UnderPayload, InPlace, BeyondTravel, Later, AtAnyTime)
    }
    functions = [
        kinds[kind].of_figures(model.robot, figures)
        for kind, figures in table.drop_duplicates("function")[["kind", "figures"]].to_numpy(dtype=str)
    ]
    columns = [[name for name in map(str, table) if name.startswith(word)] for word in ("slope ", "told ")]
    every = (table[name].to_numpy(dtype=float) for name in ("sd", "mean", *columns))
    sd, mean, slope, told = map(np.ascontiguousarray, every)  # as laid out, so are sums over them to the last bit
    return ErrorModel(
        tuple(functions), sd, mean, slope, told, offset[columns[0]].to_numpy(dtype=float), float(offset["sd"])
    )


@lru_cache(maxsize=8)
def _with(model: Model, functions: tuple[SmoothFunction, ...]) -> Model:
    """Return a model with functions beside it; made once, since its derivatives take longer than their values."""
    return replace(model, probes=functions)


INSIDE = 1e-9  # of the room there is: how far from a bound a step ends


def beside_smooth_errors(sizes: SmoothSizes, elsewhere: float) -> tuple[Fit, ErrorModel]:
    """Return how sure a fitted model is beside the smooth errors that the data allow, and what positions err by.

    The estimate stays: without the functions' own values, which are not the robot's alone, it predicts poses like those fitted
    better than that of generalised least squares does, and its distance from that counts as an error. What a lens or a target
    errs by makes the parameters less sure and moves the estimate; where the robot is it says nothing of.

    Args:
        sizes: those of the smooth errors beside the model.
        elsewhere: what it errs by beyond noise and parameters at poses left out, per axis [m]: counts where nothing smooth shows.
    """
    result, problem, variance = sizes.result, sizes.result.problem, sizes.variance
    model, estimate = result.model, result.estimate
    kept = sizes.kept
    functions = tuple(dict.fromkeys(sizes.of_amplitude[number][1] for number in kept))
    device = problem.device if sizes.known else 0.0
    # Without functions it is the fit's own, which counts what it lacks.
    level = sizes.components.level(variance) if functions else 1.0
    rest = float(np.sqrt(max(level * problem.scatter**2 - device**2, 0.0)))
    if not functions:
        return result, ErrorModel.white(float(np.hypot(rest, elsewhere)), len(estimate))
    size = np.sqrt(variance[sizes.part[kept]])
    products = sizes.products.only(kept)
    if products.size < problem.size:
        products = SlopeProducts.of(problem.reweighted(estimate, result.loss), estimate, functions)
    here = products.sized(size, level)
    offset = here.step(model, estimate)
    information, inverse = here.information(model), here.inverse
    value, axes = np.linalg.eigh(np.eye(len(inverse)) - inverse)
    errors = ErrorModel(
        functions,
        np.sqrt(level) * size * usual_sizes(model, functions),
        -inverse @ (here.functions_left + here.mixed.T @ offset),
        np.ascontiguousarray(inverse @ here.mixed.T),
        np.ascontiguousarray((axes * np.sqrt(np.maximum(value, 0.0)))[:, value > TOLD]),
        offset,
        rest,
    )
    of_robot = np.array([not function.of_images for function in errors.function_of], dtype=bool)
    # Of the inverse of the covariance and the offset's square (Sherman and Morrison 1950).
    along = information @ offset
    unsure = replace(result, information=information - np.outer(along, along) / (1 + along @ offset))
    return unsure, errors.only(of_robot)


def usual_sizes(model: Model, functions: Sequence[SmoothFunction]) -> np.ndarray:
    """Return the usual sizes of functions' amplitudes before any data, shape (n_functions,)."""
    sd = replace(model, probes=tuple(functions)).prior_sd[len(model.parameters) :]
    return np.asarray(sd * np.concatenate([np.zeros(0), *(function.spectrum for function in functions)]))


@dataclass(frozen=True, eq=False)
class SmoothSizes:
    """How large smooth functions are that the data allow beside a model, and what tells so.

    result is the model as it was fitted to rows whose errors are independent, data are these rows, known says whether the device's
    noise is known apart from the fit. kinds are inputs and functions of each part; means, which a zero imitates, take no part in
    what tells its size.
    """

    result: Fit
    data: Measurements
    known: bool
    kinds: list[tuple[tuple[str, ...], list[SmoothFunction]]]
    products: SlopeProducts

    @staticmethod
    def of(result: Fit, data: Measurements, known: bool) -> SmoothSizes:
        """Linearise a fitted model and the functions about its estimate, at enough of the rows."""
        problem = result.problem.only(representative(data)).reweighted(result.estimate, result.loss)
        parts = smooth_functions(problem, result.estimate, data)
        kinds = [(inputs, [*effects, *means(effects)]) for inputs, effects in parts]
        functions = [effect for _, effects in kinds for effect in effects]
        return SmoothSizes(result, data, known, kinds, SlopeProducts.of(problem, result.estimate, functions))

    def without(self, effects: Sequence[Effect]) -> SmoothSizes:
        """Return those beside the model without some effects, that residuals depend on linearly."""
        columns = np.concatenate([self.result.model.columns(effect) for effect in effects])
        estimate = self.result.estimate.copy()
        estimate[columns] = 0.0
        products = self.products.without(columns, self.result.estimate[columns])
        return replace(self, result=replace(self.result, estimate=estimate), products=products)

    @property
    def inputs(self) -> tuple[str, ...]:
        """What those that there are depend on."""
        there = (inputs for (inputs, _), variance in zip(self.kinds, self.variance, strict=True) if variance > 0)
        return tuple(dict.fromkeys(chain.from_iterable(there)))

    @cached_property
    def of_amplitude(self) -> list[tuple[int, SmoothFunction]]:
        """The number of its part and the function that each amplitude is of, (n_functions,)."""
        every = ((k, effect) for k, (_, effects) in enumerate(self.kinds) for effect in effects)
        return [(k, effect) for k, effect in every for _ in effect.declared]

    @cached_property
    def part(self) -> np.ndarray:
        """The number of each amplitude's part, (n_functions,)."""
        return np.array([k for k, _ in self.of_amplitude], dtype=int)

    @cached_property
    def seen(self) -> np.ndarray:
        """The numbers of the amplitudes that the data show, which are all but means."""
        return np.flatnonzero([not is_mean(effect) for _, effect in self.of_amplitude])

    @cached_property
    def kept(self) -> np.ndarray:
        """The numbers of the amplitudes that there are, means only of functions that are beyond doubt."""
        here = np.where([is_mean(effect) for _, effect in self.of_amplitude], self.believed[self.part], 1.0)
        return np.flatnonzero(self.variance[self.part] * here)

    @cached_property
    def components(self) -> VarianceComponents:
        """What tells the sizes."""
        problem = self.result.problem
        floor = float(np.median((problem.sigma / problem.total) ** 2)) if self.known else 0.0
        return self.products.only(self.seen).beside(self.result, self.part[self.seen], len(self.kinds), floor)

    @cached_property
    def believed(self) -> np.ndarray:
        """Each part's most likely variance, likewise, zero where the data do not show it beyond doubt, (n_parts,)."""
        return self.components.believed()

    @cached_property
    def variance(self) -> np.ndarray:
        """Each part's, over its functions' usual ones and the noise's level, (n_parts,)."""
        variance = self.components.expected(self.believed)
        shown = np.diag(self.products.functions)[self.seen]
        moved = np.bincount(self.part[self.seen], shown, len(self.kinds)) * variance
        return np.where(moved > VISIBLE * self.products.size, variance, 0.0)


@dataclass(frozen=True, eq=False)
class SlopeProducts:
    """Products over all rows of whitened slopes and residuals at a point: what a linear fit beside functions needs.

    fitted (n, n) are those of the parameters' slopes with each other, mixed (n, m) with the functions', of their size, functions
    (m, m) those of these; fitted_left (n,), functions_left (m,) and left are those with the residual. size is how many residuals
    there are.
    """

    fitted: np.ndarray
    mixed: np.ndarray
    functions: np.ndarray
    fitted_left: np.ndarray
    functions_left: np.ndarray
    left: float
    size: int

    @staticmethod
    def of(problem: LeastSquares, estimate: np.ndarray, functions: Sequence[SmoothFunction]) -> SlopeProducts:
        """Add them up row by row, functions of their usual sizes."""
        probe, n = Probe.of(problem, estimate, functions).compiled(1), len(estimate)
        total = np.zeros((probe.shape[1] + 1, probe.shape[1] + 1))
        for _, left, slopes in probe.parts():
            both = np.column_stack([slopes, left])
            total += both.T @ both
        usual = np.concatenate([np.ones(n), usual_sizes(problem.model, functions), [1.0]])
        total *= np.outer(usual, usual)
        return SlopeProducts(
            total[:n, :n],
            total[:n, n:-1],
            total[n:-1, n:-1],
            total[:n, -1],
            total[n:-1, -1],
            float(total[-1, -1]),
            problem.size,
        )

    def only(self, kept: np.ndarray) -> SlopeProducts:
        """Return those of some functions, given by their numbers."""
        return replace(
            self,
            mixed=self.mixed[:, kept],
            functions=self.functions[np.ix_(kept, kept)],
            functions_left=self.functions_left[kept],
        )

    def without(self, columns: np.ndarray, values: np.ndarray) -> SlopeProducts:
        """Return those of a model without some parameters (numbers, and their values), of which residuals are a linear function."""
        left = self.fitted_left - self.fitted[:, columns] @ values
        here = ~np.isin(np.arange(len(left)), columns)
        return replace(
            self,
            fitted=self.fitted * np.outer(here, here),
            mixed=self.mixed * here[:, None],
            fitted_left=left * here,
            functions_left=self.functions_left - values @ self.mixed[columns],
            left=self.left - float(values @ (self.fitted_left + left)[columns]),
        )

    def sized(self, size: np.ndarray, level: float) -> SlopeProducts:
        """Return those of functions of other sizes (m,), these and the noise of as many times the variance."""
        root = level**0.5
        return replace(
            self,
            fitted=self.fitted / level,
            mixed=self.mixed * size / root,
            functions=size[:, None] * self.functions * size,
            fitted_left=self.fitted_left / level,
            functions_left=self.functions_left * size / root,
            left=self.left / level,
        )

    @cached_property
    def inverse(self) -> np.ndarray:
        """The covariance of the functions' amplitudes where the parameters are given, (m, m)."""
        return np.linalg.inv(np.eye(len(self.functions)) + self.functions)

    def information(self, model: Model) -> np.ndarray:
        """Return what is known of the parameters beside the functions, priors included, (n, n)."""
        return np.asarray(self.fitted - self.mixed @ self.inverse @ self.mixed.T + np.diag(model.prior_sd**-2.0))

    def step(self, model: Model, estimate: np.ndarray) -> np.ndarray:
        """Return by how much the parameters (n,) are to move from the point for the greatest posterior density within bounds."""
        pull = (estimate - model.prior_mean) / model.prior_sd**2
        gradient = self.fitted_left - self.mixed @ self.inverse @ self.functions_left + pull
        factor = np.linalg.cholesky(self.information(model) * np.outer(model.prior_sd, model.prior_sd))
        target = -scipy.linalg.solve_triangular(factor, model.prior_sd * gradient, lower=True)
        room = ((model.bounds.T - estimate) / model.prior_sd) * (1 - INSIDE)
        return np.asarray(model.prior_sd * scipy.optimize.lsq_linear(factor.T, target, room).x)

    def beside(self, result: Fit, part: np.ndarray, n_parts: int, floor: float) -> VarianceComponents:
        """Return the variance components of the functions beside a fit's free parameters; part (m,) numbers their parts."""
        model, free = result.model, np.flatnonzero(~result.at_bound)
        offset = (result.estimate - model.prior_mean) / model.prior_sd
        factor = np.linalg.cholesky(self.fitted[np.ix_(free, free)] + np.diag(model.prior_sd[free] ** -2.0))
        imitated = scipy.linalg.solve_triangular(factor, self.mixed[free], lower=True)
        gradient = scipy.linalg.solve_triangular(factor, (self.fitted_left + offset / model.prior_sd)[free], lower=True)
        return VarianceComponents(
            part,
            n_parts,
            self.functions - imitated.T @ imitated,
            self.functions_left - imitated.T @ gradient,
            float(self.left + offset @ offset - gradient @ gradient),
            self.size - result.effective_parameters,
            floor,
        )


CANDIDATE_SIZES = 65  # of a curve, over the usual one
MOMENT = 1.0  # s after the measurement, from which on what a cause moved counts
NOTHING_TOLD = 1e-12  # of a variance that the data leave as it was


def beyond_measured(errors: ErrorModel, sizes: SmoothSizes) -> ErrorModel:
    """Return an error model with what errs beyond what was measured: a curve by as much as there, a wander as a random walk.

    What a cause says of the device's frame is a wander, too: it is as large as the data tell without that cause, and begins where
    that leaves it. In the measurement the cause says it, and it is none of the robot's. Where there is none, a warm-up may stand
    in its place: how that goes on is as much of a guess.

    Args:
        errors: what the model leaves of rows.
        sizes: those of the smooth errors beside it.
    """
    return _beyond_time(_beyond_travel(errors, sizes.result, sizes.data), sizes)


def _beyond_travel(errors: ErrorModel, result: Fit, data: Measurements) -> ErrorModel:
    model, estimate = result.model, result.estimate
    travels = []
    for cause in (effect for effect in model.effects if isinstance(effect, Cause)):
        if cause.joint and (travel := cause.effect.travel(cause.joint)):
            columns = model.columns(cause)
            usual, variance = model.prior_sd[columns], np.diag(result.covariance)[columns]
            whole = float(ca.evalf(cause.effect.size(ca.SX(usual))))
            size = whole * float(np.sqrt(mean_square_size(estimate[columns], variance, usual**2)))
            travels.append(BeyondTravel(data.robot, cause.joint - 1, *travel, size))
    sd = usual_sizes(model, travels)
    return errors.with_functions(travels, sd)


def mean_square_size(estimate: np.ndarray, variance: np.ndarray, usual: np.ndarray) -> float:
    """Return the mean square of how many times as large as usual amplitudes are, over all that their estimates allow.

    Of estimates between nothing and what the data say, the sum of squares is that of a chi-squared distribution (Satterthwaite
    1946); before the data sizes are as those of causes (see `variance_components`).

    Args:
        estimate: of the amplitudes, (n,).
        variance: of these, (n,).
        usual: the variance before the data, (n,).
    """
    told = np.maximum(usual - variance, NOTHING_TOLD * usual)
    sizes = np.geomspace(SIZES.min(), SIZES.max(), CANDIDATE_SIZES)
    expected = told / usual * (sizes[:, None] ** 2 * told + variance)
    whole = expected.sum(axis=1)
    freedom = whole**2 / (expected**2).sum(axis=1)
    logs = scipy.stats.chi2.logpdf(estimate @ estimate * freedom / whole, freedom) + np.log(freedom / whole)
    logs -= np.log(np.maximum(sizes, 1.0))
    weight = np.exp(logs - logs.max())
    return float(weight @ sizes**2 / weight.sum())


def _beyond_time(errors: ErrorModel, sizes: SmoothSizes) -> ErrorModel:
    result, data = sizes.result, sizes.data
    causes = [effect for effect in result.model.effects if effect.family == OF_THE_FRAME]
    trends = causes or [effect for effect in result.model.effects if _warms_up(effect)]
    steps, left = in_time(data), _walks(sizes)
    if not steps or not (trends or any(left.values())):
        return errors
    by_order = steps[0].clock == "order"
    if by_order:
        # It counts anew in each measurement.
        errors = errors.only(
            np.array([not isinstance(function, InTime) for function in errors.function_of], dtype=bool)
        )
    walks = _walks(sizes.without(trends)) if trends else left
    for of, walk in walks.items():
        functions: list[SmoothFunction]
        if by_order:
            # Also for causes: what they say of other rows and what is there are two wanders.
            functions = [*in_time(data, of)]
            share = np.full(len(functions), walk * (np.sqrt(2) if causes else 1.0))
        else:
            functions = [kind(data.robot, of, begin=steps[0].begin, end=steps[-1].end) for kind in (Later, AtAnyTime)]
            share = np.array([WALK * walk, left[of]])
        sd = usual_sizes(result.model, functions)
        sd = sd * np.repeat(share, len(sd) // len(share))
        # What is nothing would only be worked out at every row that is predicted.
        if sd.any():
            errors = errors.with_functions(functions, sd)
    if causes and not by_order:
        moved, end = _moved(causes, result, data), steps[-1].end
        come = [InTime(data.robot, begin=end, end=end + MOMENT)]
        errors = errors.with_functions(come, np.abs(moved), np.sign(moved))
    return errors


def _warms_up(effect: Effect) -> bool:
    acting = effect.effect if isinstance(effect, Cause) else effect
    return isinstance(acting, Warming) and acting.constant > 0


def _walks(sizes: SmoothSizes) -> dict[str, float]:
    """How large random walks in time are that are left, of each quantity that may walk, over the usual size; 0 where none is."""
    level = sizes.components.level(sizes.variance)
    return {
        functions[0].of: float(np.sqrt(level * variance))
        for (_, functions), variance in zip(sizes.kinds, sizes.variance, strict=True)
        if isinstance(functions[0], InTime)
    }


def _moved(causes: Sequence[Effect], result: Fit, data: Measurements) -> np.ndarray:
    """By how much causes have moved what a device reports when the measurement ends, on average (3,) [m]."""
    model, still = result.model, result.estimate.copy()
    for cause in causes:
        still[model.columns(cause)] = 0.0
    last = {name: data.table[name].max() for name in ("time", "order") if name in data.table}
    rows = replace(data, table=data.table.assign(**last)).conditions
    return np.asarray((model.position(result.estimate, rows) - model.position(still, rows)).mean(axis=0))
