"""The posterior of the calibrated tool's error over its task, with effects that the model may lack though unproven.

Candidates for lacking effects are the causes of the catalogue, a smooth background along any input, or an independent
error of each pose. Each adds columns with amplitudes b ~ N(0, size²), so that its marginal likelihood has a closed form
(Kass and Raftery 1995) without a refit; pairs are not considered, since proven causes are in the model.

A draw from the posterior is a robot compatible with the data: its parameters, one lacking effect (see `MissingEffects`), one of
the diagnosis' rivals in a cause's place, and the excess error of poses left out in turn (see `LeftOut`). Smooth lacking
errors are drawn from the error model, of all inputs together, if it has any; otherwise there are none, since an average
size over all robots fits hardly any single one. The error is the distance of the draw's tool from the model's, without
device noise, and the share of draws within a tolerance is the probability of meeting it, at any stopping time (Berger
1985, 7.7).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calflow.design.discrimination import rows_like
from calflow.design.planned import Measure, Planned, Task
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Held, Regressors
from calflow.diagnosis.screening import Catalogue, Screening
from calflow.diagnosis.verdict import label
from calflow.effects import Effect
from calflow.effects.base import Cause
from calflow.estimation.calibrated_model import Alternative, offsets
from calflow.estimation.noise import PerUnit
from calflow.estimation.probing import probed
from calflow.estimation.smooth_functions import Wandering, smooth_functions
from calflow.estimation.variance_components import LOG_PRIOR, SIZES, directions, explained
from calflow.measurements.series import Series
from calflow.observations.position import Position

Kind = Literal["nothing", "cause", "background", "pose"]
ERROR_KINDS: tuple[Kind, ...] = ("nothing", "cause", "background", "pose")  # of equal prior probability
TIMES_NOISE = 2.0 ** np.arange(-3.0, 4.5, 0.5)  # sizes of a background relative to the noise
UNINFORMATIVE = 0.98  # posterior over prior variance above which the data are uninformative
TASK_DRAWS = 2000


def _is_device_drift(effect: Effect) -> bool:
    return isinstance(effect, Wandering) and effect.quantity.of_measuring()


@dataclass(frozen=True, eq=False)
class Form:
    """A form of a lacking effect: effects at zero, which of their columns are its own, and their usual sizes (n,)."""

    kind: Kind
    name: str
    effects: tuple[Effect, ...]
    columns: np.ndarray
    sd: np.ndarray

    @property
    def of_robot(self) -> bool:
        """Whether it moves the tool, unlike errors of the measuring device."""
        if self.kind == "background":
            return not any(_is_device_drift(effect) for effect in self.effects)
        return not any(isinstance(effect, Cause) and effect.of_measuring() for effect in self.effects)


@dataclass(frozen=True, eq=False)
class WeightedForm:
    """A form of given size (of its amplitudes in units of sd), with its log weight: prior times marginal likelihood."""

    form: Form
    size: float
    log_weight: float

    @property
    def independent(self) -> float:
        """Size of an independent error of each row, relative to the noise."""
        return self.size if self.form.kind == "pose" else 0.0


@dataclass(frozen=True, eq=False)
class MissingEffects:
    """The weighted candidates for missing effects, and the screening of all their columns beside the model's parameters.

    scatter [m]: standard deviation per axis of further errors of rows.
    """

    fitted: Fitted
    effects: tuple[Effect, ...]
    screening: Screening[Cause]
    every: tuple[WeightedForm, ...]
    scatter: float

    @staticmethod
    def of(fitted: Fitted, catalogue: Catalogue) -> MissingEffects:
        """Return the weights of all effects that a fitted model may lack beside the noise.

        A significant discrepancy is not one of them: it is among the sizes of the independent error of each pose.
        """
        bare = replace(fitted, background=None, noise=replace(fitted.noise, discrepancy=PerUnit()))
        kinds = [(inputs, effects) for inputs, effects in smooth_functions(bare.problem, bare.fit.estimate, bare.data)]
        smooth = [effect for _, effects in kinds for effect in effects]
        effects = (*catalogue.effects, *smooth)
        regressors = bare.regressors(effects)
        seen = Screening(regressors)
        n_smooth = sum(len(effect.declared) for effect in smooth)
        forms = [*_causes(regressors, fitted.causes, smooth), *_backgrounds(regressors, kinds, n_smooth)]
        weighed = [lack for kind in ERROR_KINDS for lack in _weighted(seen, kind, forms)]
        return MissingEffects(fitted, effects, seen, tuple(weighed), bare.problem.scatter)

    @cached_property
    def weights(self) -> np.ndarray:
        """The posterior probabilities, shape (n_lacks,)."""
        logs = np.array([lack.log_weight for lack in self.every])
        return np.asarray(np.exp(logs - scipy.special.logsumexp(logs)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Posterior covariance of the free parameters if the model lacks nothing, (n_free, n_free)."""
        return self.parameters(0.0)[1]

    def parameters(self, independent: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n_free,), relative to the estimate, and covariance (n_free, n_free) of the free parameters.

        independent: size of an independent error of each row, relative to the noise.
        """
        louder = _with_independent(self.screening.regressors, independent)
        root = louder.root_covariance(np.arange(len(louder.change)))
        return louder.change, root.T @ root

    def amplitude(self, lack: WeightedForm) -> tuple[np.ndarray, np.ndarray]:
        """Return posterior mean (n,) and covariance (n, n) of a lack's amplitudes, in their own units."""
        columns, sd = lack.form.columns, lack.form.sd * lack.size
        shown = self.screening.information(columns) * np.outer(sd, sd)
        covariance = np.linalg.inv(np.eye(len(columns)) + shown)
        return -sd * (covariance @ (sd * self.screening.score[columns])), covariance * np.outer(sd, sd)

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return the change of the fitted parameters by a unit of each column, (n_free, n_columns)."""
        return np.asarray(-self.covariance @ self.screening.regressors.products.mixed[:, columns])

    def probability(self, kind: Kind, name: str = "") -> float:
        """Return the posterior probability of a kind, or of all its sizes and forms of a name."""
        asked = [lack.form.kind == kind and (not name or lack.form.name == name) for lack in self.every]
        return float(self.weights[np.array(asked)].sum())


def _causes(regressors: Regressors[Cause], causes: Sequence[Cause], smooth: Sequence[Effect]) -> Iterator[Form]:
    """Yield the forms of every cause that the model does not have at the same place."""
    places, decoys = {cause.place for cause in causes}, set(map(id, smooth))
    for candidate in regressors.candidates:
        cause, columns = candidate.cause, candidate.columns
        if id(cause.effect) not in decoys and cause.place not in places:
            yield Form("cause", label(cause.id, cause.joint), (cause,), columns, regressors.prior_sd[columns])


def _backgrounds(
    regressors: Regressors[Cause], kinds: Sequence[tuple[tuple[str, ...], Sequence[Effect]]], n_smooth: int
) -> Iterator[Form]:
    """Yield smooth functions of each input, of the noise's size over the rows; their columns come last."""
    start = regressors.matrix.shape[1] - n_smooth
    for inputs, effects in kinds:
        number = sum(len(effect.declared) for effect in effects)
        columns = start + np.arange(number)
        spectrum = np.concatenate([effect.spectrum for effect in effects])  # type: ignore[attr-defined]
        sd = regressors.prior_sd[columns] * spectrum
        moved = float(np.sqrt(regressors.products.squared[columns] @ sd**2 / len(regressors.residual)))
        start += number
        if moved > 0:
            yield Form("background", " and ".join(inputs), tuple(effects), columns, sd / moved)


def _weighted(seen: Screening[Cause], kind: Kind, forms: Sequence[Form]) -> Iterator[WeightedForm]:
    """Yield the weighted forms of one kind: equal priors for its names, and within each for forms and sizes."""
    nothing = Form(kind, kind, (), np.arange(0), np.zeros(0))
    if kind == "nothing":
        yield WeightedForm(nothing, 0.0, 0.0)
    elif kind == "pose":
        for size in TIMES_NOISE:
            yield WeightedForm(
                nothing, float(size), _independent_likelihood(seen, float(size)) - np.log(len(TIMES_NOISE))
            )
    else:
        of_kind = [form for form in forms if form.kind == kind]
        names = Counter(form.name for form in of_kind)
        sizes = SIZES if kind == "cause" else TIMES_NOISE
        prior = LOG_PRIOR if kind == "cause" else np.full(len(sizes), -np.log(len(sizes)))
        for form in of_kind:
            weights = _likelihoods(seen, form, sizes) + prior - np.log(len(names) * names[form.name])
            for size, log_weight in zip(sizes, weights, strict=True):
                yield WeightedForm(form, float(size), float(log_weight))


def _likelihoods(seen: Screening[Cause], form: Form, sizes: np.ndarray) -> np.ndarray:
    """Return the log marginal likelihood with a form of each size, relative to that without it, shape (n_sizes,)."""
    shown = seen.information(form.columns) * np.outer(form.sd, form.sd)
    fallen, narrowed = explained(*directions(shown, form.sd * seen.score[form.columns]), sizes)
    return (fallen - narrowed) / 2


def _independent_likelihood(seen: Screening[Cause], size: float) -> float:
    """Return the same for an independent error of each row."""
    louder = _with_independent(seen.regressors, size)
    spent = len(seen.regressors.residual) * float(np.log1p(size**2)) + louder.narrowed - seen.narrowed
    return (seen.chi2 - louder.chi2 - spent) / 2


def _with_independent(regressors: Regressors[Cause], size: float) -> Screening[Cause]:
    """Return the linearised model with an independent error of each row, which is equivalent to larger noise."""
    scale, none = (1 + size**2) ** -0.5, Held(np.empty((len(regressors.residual), 0)))
    alone = replace(regressors.moving(none), candidates=())
    return Screening(replace(alone, residual=scale * alone.residual, jacobian=scale * alone.jacobian))


@dataclass(frozen=True, eq=False)
class TaskError:
    """Posterior draws (n_draws,) [m] of the tool's true error over the task: its root mean square or worst point.

    lacking: the same with all parameters known, which no further measurement of this kind reduces; left: the name of
    the lacking effect of each draw.
    """

    every: np.ndarray
    lacking: np.ndarray
    left: tuple[str, ...]

    def probability(self, tolerance: float) -> float:
        """Return the probability that the error is within a tolerance [m]."""
        return float(np.mean(self.every <= tolerance))

    def within_at_best(self, tolerance: float) -> float:
        """Return the same with all parameters known: the limit for more poses if these reveal no further cause."""
        return float(np.mean(self.lacking <= tolerance))

    def quantile(self, share: float) -> float:
        """Return a quantile [m] of the error."""
        return float(np.quantile(self.every, share))


@dataclass(frozen=True, eq=False)
class TaskSlopes:
    """The task of the fitted model: packed rows (n_conditions, n_points), and the tool's Jacobian there.

    slopes (n_points, 3, n_parameters) [m]: derivatives by the parameters.
    """

    fitted: Fitted
    conditions: np.ndarray
    slopes: np.ndarray

    @staticmethod
    def of(fitted: Fitted, task: Task, rng: np.random.Generator) -> TaskSlopes:
        """Return the task's points, with conditions other than readings and payload like those of the measured rows."""
        conditions = rows_like(fitted.data, task.readings, list(task.payloads), rng).conditions
        return TaskSlopes(fitted, conditions, fitted.model.point_jacobian(fitted.fit.estimate, conditions))

    def moved(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return the Jacobian of the tool's points by effects at zero, (n_points, 3, n_columns) [m]."""
        whole, perfect = self.fitted.model, Planned(Position.planned(Series()), 1.0)
        model = replace(whole, observations=(perfect.observation,))
        estimate = whole.handed_on(self.fitted.fit.estimate, model)
        _, slopes = probed(perfect.problem(model, estimate, self.conditions), estimate, effects)
        return np.asarray(slopes.reshape(*self.slopes.shape[:2], -1)[:, :, len(estimate) :])

    @property
    def taught(self) -> np.ndarray:
        """Orthonormal displacements (3 n_points, n) by coordinates of the tool point that the data do not determine."""
        fit, markers = self.fitted.fit, self.fitted.data.robot.markers
        unknown = [
            k
            for k, (parameter, variance) in enumerate(zip(fit.model.parameters, np.diag(fit.covariance), strict=True))
            if parameter.part in markers and variance > UNINFORMATIVE * parameter.prior_sd**2
        ]
        return np.asarray(np.linalg.qr(self.slopes[:, :, unknown].reshape(3 * len(self.slopes), len(unknown)))[0])

    def left(self, missing: MissingEffects, forms: Sequence[Form]) -> Iterator[np.ndarray]:
        """Yield for each form the tool's displacement by a unit of each column, after refitting, (n_points, 3, n)."""
        free = self.slopes[:, :, np.flatnonzero(~self.fitted.fit.at_bound)]
        moved = self.moved(missing.effects)
        for form in forms:
            yield free @ missing.response(form.columns) + (moved[:, :, form.columns] if form.of_robot else 0.0)


def task_error(
    missing: MissingEffects,
    rivals: Sequence[Sequence[Alternative]],
    at_task: TaskSlopes,
    measure: Measure,
    rng: np.random.Generator,
) -> TaskError:
    """Return posterior draws of the calibrated tool's error over the task.

    A tool point that the data do not determine, as with images, must be taught: errors that teaching removes do not
    count.
    rivals: alternatives for each cause that was found, of which one or none is true.
    """
    fitted = missing.fitted
    lack = rng.choice(len(missing.every), TASK_DRAWS, p=missing.weights)
    drawn = [(missing.every[k], np.flatnonzero(lack == k)) for k in np.unique(lack)]
    error, lacking = _without_smooth(at_task, missing, drawn, rng)
    if fitted.errors.functions:
        smooth = np.isin(lack, [k for k, candidate in enumerate(missing.every) if candidate.form.kind == "background"])
        error[smooth], lacking[smooth] = (part[smooth] for part in _smooth(at_task, fitted, rng))
        drawn = [(candidate, draws) for candidate, draws in drawn if candidate.form.kind != "background"]
    for others in rivals:
        of_choice = [alternative.probability for alternative in others]
        chosen = rng.choice(len(others) + 1, TASK_DRAWS, p=[*of_choice, 1 - sum(of_choice)])
        moved = offsets(others, fitted.model, fitted.fit.estimate, at_task.conditions)
        for k in range(len(others)):
            lacking[chosen == k] += moved[:, :, k]
    forms = list({id(candidate.form): candidate.form for candidate, _ in drawn}.values())
    slopes = dict(zip(map(id, forms), at_task.left(missing, forms), strict=True))
    for candidate, draws in drawn:
        shape = lacking[draws].shape
        if candidate.independent:
            lacking[draws] += candidate.independent * missing.scatter * rng.standard_normal(shape)
        elif len(candidate.form.columns):
            mean, covariance = missing.amplitude(candidate)
            amplitude = mean + _normal(len(draws), covariance, rng)
            lacking[draws] += np.einsum("nab,kb->kna", slopes[id(candidate.form)], amplitude, optimize=True)
    taught = at_task.taught
    error, lacking = (
        off - ((off.reshape(TASK_DRAWS, -1) @ taught) @ taught.T).reshape(off.shape) for off in (error, lacking)
    )
    names = tuple(missing.every[k].form.name for k in lack)
    return TaskError(_size(error + lacking, measure), _size(lacking, measure), names)


def _without_smooth(
    at_task: TaskSlopes,
    missing: MissingEffects,
    drawn: Sequence[tuple[WeightedForm, np.ndarray]],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw parameter errors, and the errors with parameters known (n_draws, n_points, 3) [m], without smooth errors.

    drawn: the lacking effects, and the draws of each.
    """
    fitted, free = missing.fitted, np.flatnonzero(~missing.fitted.fit.at_bound)
    drawn_parameters, level = np.empty((TASK_DRAWS, len(free))), _levels(fitted, rng)
    for independent in {lack.independent for lack, _ in drawn}:
        joined = np.concatenate([draws for lack, draws in drawn if lack.independent == independent])
        mean, covariance = missing.parameters(independent)
        drawn_parameters[joined] = mean + level[joined, None] * (_normal(len(joined), covariance, rng))
    error = np.einsum("nap,kp->kna", at_task.slopes[:, :, free], drawn_parameters, optimize=True)
    elsewhere = fitted.left_out.drawn(TASK_DRAWS, rng)
    # An independent error of each pose cannot be distinguished from unknown noise.
    apart = 0.0 if fitted.noise.known else missing.scatter
    lacking = np.hypot(apart, elsewhere)[:, None, None] * rng.standard_normal(error.shape)
    return error, lacking


def _smooth(at_task: TaskSlopes, fitted: Fitted, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw parameter errors, and the errors with parameters known (n_draws, n_points, 3) [m], by the error model.

    Drift of the measuring device does not move the tool.
    """
    errors = fitted.errors.only(lambda function: not _is_device_drift(function))
    moved = errors.at(fitted.model, fitted.fit.estimate, at_task.conditions).moved
    off = _normal(TASK_DRAWS, fitted.covariance - np.outer(errors.offset, errors.offset), rng)
    slopes = at_task.slopes - moved @ errors.slope
    left = errors.mean + rng.standard_normal((TASK_DRAWS, len(errors.sd))) @ errors.spread.T
    smooth = np.einsum("nas,ks->kna", moved, left, optimize=True)
    smooth += errors.rest * rng.standard_normal(smooth.shape)
    smooth += at_task.slopes @ errors.offset
    return np.einsum("nap,kp->kna", slopes, off, optimize=True), smooth


def _normal(number: int, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw so many normal vectors (number, n) about zero."""
    value, turned = np.linalg.eigh(covariance)
    return np.asarray(rng.standard_normal((number, len(value))) * np.sqrt(np.maximum(value, 0.0)) @ turned.T)


def _levels(fitted: Fitted, rng: np.random.Generator) -> np.ndarray:
    """Draw the ratio of true to assumed noise, (n_draws,), by the degrees of freedom of the repeats."""
    scatter = fitted.noise.scatter
    freedom = float(scatter.freedom.sum()) if scatter is not None and "repeats" in fitted.noise.sources else np.inf
    return (
        np.ones(TASK_DRAWS)
        if not np.isfinite(freedom)
        else np.sqrt(freedom / rng.chisquare(max(freedom, 1.0), TASK_DRAWS))
    )


def _size(error: np.ndarray, measure: Measure) -> np.ndarray:
    """Return the root mean square or largest length (n_draws,) of errors (n_draws, n_points, 3)."""
    squared = (error**2).sum(axis=2)
    return np.asarray(np.sqrt(squared.max(axis=1) if measure == "worst" else squared.mean(axis=1)))
