"""The error model: what a calibrated model errs by beside its device's noise.

Residuals are white noise and random smooth functions of joints, place, payload and time, each input's of the size that the data
allow (see `variance_components`). Beside them the parameters are as sure as by generalised least squares (Aitken 1936): a smooth
misfit is not taken for as many independent errors as it has rows, and what carries it elsewhere is not taken for sure.

A prediction errs by its parameters' errors and by the functions, both given the data: little between poses that were measured,
by the functions' full size far from them. Of time nothing is known beyond the measurement, where a wander goes on as a random walk.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
import pandas as pd
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.probing import Probe
from calflow.estimation.smooth_functions import (
    TURNS,
    BeyondTravel,
    InPlace,
    InTime,
    JointField,
    Shift,
    SmoothFunction,
    UnderPayload,
    in_time,
    smooth_functions,
)
from calflow.estimation.variance_components import VarianceComponents
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.mechanism import Row

TOLD = 1e-2  # of a direction's variance: what the data take away less of, they tell nothing about
ROWS = 1000  # at which the functions' slopes are there at once
VISIBLE = 0.02  # of the white noise's variance: a part that moves residuals by less is none
# Cosines and sines of k half turns a span, of sizes 1/k, differ as a random walk does: after a time t by pi² t / span, where
# their own variance is the sum of 1/k².
WALK = np.pi**2


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
    def inputs(self) -> tuple[str, ...]:
        """What the functions depend on."""
        return tuple(dict.fromkeys(name for function in self.functions for name in function.inputs))

    def variance(
        self, model: Model, estimate: np.ndarray, covariance: np.ndarray, conditions: np.ndarray
    ) -> np.ndarray:
        """Return the variance of rows' positions per axis, that of the parameters in it, shape (n_rows, 3) [m²].

        It is the mean square by which the model without these functions errs, so that what is known of them counts whole.
        """
        parts = _parts(conditions)
        jacobians = (model.point_jacobian(estimate, part) for part in parts)
        at_rows = (self.at(model, estimate, part) for part in parts)
        return np.concatenate(
            [at.variance(jacobian, covariance) for at, jacobian in zip(at_rows, jacobians, strict=True)]
        )

    def left_variance(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the same where the parameters are given, shape (n_rows, 3) [m²]."""
        return np.concatenate([self.at(model, estimate, part).given for part in _parts(conditions)])

    def at(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> ErrorsAtRows:
        """Return what positions of rows err by."""
        moved = self._moved(model, estimate, conditions)
        unknown = self._unknown_times(model, conditions)
        later = (moved[:, :, self._of_time] ** 2).sum(axis=2) * unknown[:, None]
        moved[:, :, self._of_time] *= (unknown == 0)[:, None, None]
        return ErrorsAtRows(self, moved, self.rest**2 + later)

    def _moved(self, model: Model, estimate: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """What each function of its usual size does to reported positions, shape (n_rows, 3, n_functions) [m]."""
        if not self.functions:
            return np.zeros((conditions.shape[1], 3, 0))
        beside, n = _with(model, self.functions), len(estimate)
        at = np.append(estimate, beside.nominal[n:])
        return np.asarray(beside.position_jacobian(at, conditions)[:, :, n:] * self.sd)

    @cached_property
    def _of_time(self) -> np.ndarray:
        """Which amplitudes are of functions of time or order, shape (n_functions,)."""
        return np.array([isinstance(one, InTime) for one in self.functions for _ in one.declared], dtype=bool)

    def _unknown_times(self, model: Model, conditions: np.ndarray) -> np.ndarray:
        """Return how large a wander's variance is at each row, over what it is within the measurement; 0 at times within it.

        Orders count anew in each measurement: nothing is known there.
        """
        measured = next((one for one in self.functions if isinstance(one, InTime)), None)
        n_rows = conditions.shape[1]
        if measured is None:
            return np.zeros(n_rows)
        if measured.clock != "time" or "time" not in model.given:
            return np.ones(n_rows)
        (time,) = conditions[Row.spans(model.robot, model.given)["time"]]
        beyond = np.maximum(np.maximum(measured.begin - time, time - measured.end), 0.0)
        waves = sum(1 / k**2 for k in range(1, TURNS + 1))
        span = measured.end - measured.begin or 1.0
        return np.where(beyond > 0, 1 + WALK / waves * beyond / span, 0.0)


def _parts(conditions: np.ndarray) -> list[np.ndarray]:
    """Packed rows, not too many at once."""
    return np.array_split(conditions, range(ROWS, conditions.shape[1], ROWS), axis=1)


@dataclass(frozen=True, eq=False)
class ErrorsAtRows:
    """What positions of some rows err by beside the parameters' errors.

    moved (n_rows, 3, n_functions) [m] is what a function of its size does, apart (n_rows, 3) [m²] the variance of what errs
    row by row, or is not told at all.
    """

    of: ErrorModel
    moved: np.ndarray
    apart: np.ndarray

    @property
    def unsure(self) -> np.ndarray:
        """The variance of the errors where the parameters are given, shape (n_rows, 3) [m²]."""
        smooth = (self.moved**2).sum(axis=2) - ((self.moved @ self.of.told) ** 2).sum(axis=2)
        return np.asarray(self.apart + np.maximum(smooth, 0.0))

    @property
    def given(self) -> np.ndarray:
        """The mean square of the errors where the parameters are given, shape (n_rows, 3) [m²]."""
        return np.asarray(self.unsure + (self.moved @ self.of.mean) ** 2)

    def variance(self, jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return the mean square of the errors (n_rows, 3) [m²], the parameters' in it.

        Args:
            jacobian: of the positions by the parameters, (n_rows, 3, n_parameters).
            covariance: of the parameters, their offset in it.
        """
        slopes = jacobian - self.moved @ self.of.slope
        apart = slopes @ self.of.offset
        off = apart + self.moved @ (self.of.slope @ self.of.offset + self.of.mean)
        return np.asarray(self.unsure + np.maximum(of_parameters(slopes, covariance) - apart**2, 0.0) + off**2)


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
    amplitudes = [(k, one, first) for k, one in enumerate(errors.functions, start=1) for first in _begins(one)]
    first = np.concatenate([[errors.rest, 0.0], errors.offset, np.zeros(len(told))])
    others = np.column_stack([errors.sd, errors.mean, errors.slope, errors.told])
    named = pd.DataFrame(
        {
            "function": [0, *(number for number, *_ in amplitudes)],
            "kind": ["", *(type(one).__name__ for _, one, _ in amplitudes)],
            "figures": ["", *(one.figures_text if first else "" for _, one, first in amplitudes)],
        }
    )
    numbers = pd.DataFrame(np.vstack([first, others]), columns=["sd", "mean", *slopes, *told])
    return typed(pd.concat([named, numbers], axis=1), SmoothAmplitude)


def _begins(function: SmoothFunction) -> list[bool]:
    """Whether an amplitude is the function's first one."""
    return [k == 0 for k in range(len(function.declared))]


def read_errors(table: pd.DataFrame, model: Model) -> ErrorModel:
    """Rebuild what `error_table` wrote."""
    offset, table = table.iloc[0], table.iloc[1:]
    kinds: dict[str, type[SmoothFunction]] = {
        kind.__name__: kind for kind in (JointField, Shift, InTime, UnderPayload, InPlace, BeyondTravel)
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


def beside_smooth_errors(result: Fit, data: Measurements, known: bool, elsewhere: float) -> tuple[Fit, ErrorModel]:
    """Return how sure a fitted model is beside the smooth errors that the data allow, and what positions err by.

    The estimate stays: without the functions' own values, which are not the robot's alone, it predicts poses like those fitted
    better than that of generalised least squares does, and its distance from that counts as an error.

    Args:
        result: the model as it was fitted to rows whose errors are independent.
        data: these rows.
        known: whether the device's noise is known apart from the fit.
        elsewhere: what it errs by beyond noise and parameters at poses left out, per axis [m]: counts where nothing smooth shows.
    """
    model, estimate = result.model, result.estimate
    kinds = smooth_functions(model, estimate, data)
    part = np.repeat(np.arange(len(kinds)), [sum(len(one.declared) for one in effects) for _, effects in kinds])
    problem = result.problem.reweighted(estimate, result.loss)
    products = SlopeProducts.of(problem, estimate, [effect for _, effects in kinds for effect in effects])
    floor = float(np.median((problem.sigma / problem.total) ** 2)) if known else 0.0
    components = products.beside(result, part, len(kinds), floor)
    variance = components.expected(components.believed())
    moved = np.bincount(part, np.diag(products.functions), len(kinds)) * variance / problem.size
    variance = np.where(moved > VISIBLE, variance, 0.0)
    functions = tuple(effect for k, (_, effects) in enumerate(kinds) if variance[k] > 0 for effect in effects)
    kept = np.flatnonzero(variance[part] > 0)
    level = components.level(variance)
    size = np.sqrt(variance[part[kept]])
    here = products.only(kept).sized(size, level)
    offset = here.step(model, estimate)
    information, inverse = here.information(model), here.inverse
    value, axes = np.linalg.eigh(np.eye(len(inverse)) - inverse)
    device = problem.device if known else 0.0
    rest = float(np.sqrt(max(level * problem.scatter**2 - device**2, 0.0)))
    errors = ErrorModel(
        functions,
        np.sqrt(level) * size * _usual(model, functions),
        -inverse @ (here.functions_left + here.mixed.T @ offset),
        np.ascontiguousarray(inverse @ here.mixed.T),
        np.ascontiguousarray((axes * np.sqrt(np.maximum(value, 0.0)))[:, value > TOLD]),
        offset,
        rest if functions else float(np.hypot(rest, elsewhere)),
    )
    # Of the inverse of the covariance and the offset's square (Sherman and Morrison 1950).
    along = information @ offset
    unsure = replace(result, information=information - np.outer(along, along) / (1 + along @ offset))
    return unsure, beyond_measured(errors, model, estimate, data)


def beyond_measured(errors: ErrorModel, model: Model, estimate: np.ndarray, data: Measurements) -> ErrorModel:
    """Return an error model with what causes that are curves do where and when they were not measured: as much as there."""
    causes = [effect for effect in model.effects if isinstance(effect, Cause)]
    sizes = [float(ca.evalf(cause.size(ca.SX(estimate[model.columns(cause)])))) for cause in causes]
    travels = tuple(
        BeyondTravel(data.robot, cause.joint - 1, *travel, max(size, float(model.prior_sd[model.columns(cause)].max())))
        for cause, size in zip(causes, sizes, strict=True)
        if cause.joint and (travel := cause.effect.travel(cause.joint))
    )
    wander = float(np.hypot.reduce([size for cause, size in zip(causes, sizes, strict=True) if cause.effect.smooth_in]))
    waves = tuple(in_time(data)) if wander else ()
    functions = (*travels, *waves)
    if not functions:
        return errors
    usual = _usual(model, functions)
    n_told, n = 6 * len(waves), len(usual)
    if n_told:  # of any phase along each of three axes
        usual[n - n_told :] *= wander * np.sqrt(2 / 3) / np.linalg.norm(usual[n - n_told :: 3])
    told = np.zeros((len(errors.sd) + n, errors.told.shape[1] + n_told))
    told[: len(errors.sd), : errors.told.shape[1]] = errors.told
    told[len(told) - n_told :, errors.told.shape[1] :] = np.eye(n_told)  # in the measurement itself the cause says it
    return ErrorModel(
        (*errors.functions, *functions),
        np.append(errors.sd, usual),
        np.append(errors.mean, np.zeros(n)),
        np.vstack([errors.slope, np.zeros((n, len(estimate)))]),
        told,
        errors.offset,
        errors.rest,
    )


def _usual(model: Model, functions: Sequence[SmoothFunction]) -> np.ndarray:
    """Return the usual sizes of functions' amplitudes before any data, shape (n_functions,)."""
    sd = replace(model, probes=tuple(functions)).prior_sd[len(model.parameters) :]
    return np.asarray(sd * np.concatenate([np.zeros(0), *(function.spectrum for function in functions)]))


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
        probe, n = Probe.of(problem, estimate, functions), len(estimate)
        usual, width = _usual(problem.model, functions), probe.shape[1] + 1
        total = np.zeros((width, width))
        for number, block in enumerate(problem.blocks):
            for part in block.parts():
                rows = len(range(len(block.rows))[part])
                both = np.zeros((rows * block.n_units, width))
                both[:, -1] = probe.of_rows(number, part, both[:, :-1])
                both[:, n:-1] *= usual
                if block.sharing:
                    apart = block.sharing.only(part).decorrelated(both.reshape(rows, block.n_units, width))
                    both = apart.reshape(-1, width)
                total += both.T @ both
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
        target = -solve_triangular(factor, model.prior_sd * gradient, lower=True)
        room = ((model.bounds.T - estimate) / model.prior_sd) * (1 - INSIDE)
        return np.asarray(model.prior_sd * lsq_linear(factor.T, target, room).x)

    def beside(self, result: Fit, part: np.ndarray, n_parts: int, floor: float) -> VarianceComponents:
        """Return the variance components of the functions beside a fit's free parameters; part (m,) numbers their parts."""
        model, free = result.model, np.flatnonzero(~result.at_bound)
        offset = (result.estimate - model.prior_mean) / model.prior_sd
        factor = np.linalg.cholesky(self.fitted[np.ix_(free, free)] + np.diag(model.prior_sd[free] ** -2.0))
        imitated = solve_triangular(factor, self.mixed[free], lower=True)
        gradient = solve_triangular(factor, (self.fitted_left + offset / model.prior_sd)[free], lower=True)
        return VarianceComponents(
            part,
            n_parts,
            self.functions - imitated.T @ imitated,
            self.functions_left - imitated.T @ gradient,
            float(self.left + offset @ offset - gradient @ gradient),
            self.size - result.effective_parameters,
            floor,
        )
