"""Lacks: what a fitted model may lack though no test has proven it, each as likely as the data leave it.

Besides nothing that is a cause of the catalogue at any place, a smooth background along any input, or an error of every pose
for itself. Each is a set of columns b ~ N(0, size²) beside the model's own parameters, so that the likelihood of the data with it
is known in closed form (Kass and Raftery 1995): nothing is fitted anew. Two at once are not weighed: what was found is in the
model.

The task error: how far the calibrated tool is off where it will work, as a posterior that counts all that may be wrong.

A draw is one robot that the data leave possible: its parameters, one of the things that the model may lack (see `Lacks`), one of
the diagnosis' rivals in a cause's place, and what poses left out in turn show beyond all that (see `LeftOut`). A robot that lacks
something smooth is drawn of the error model where that has smooth errors: of all inputs together. One that does not has none:
the size that a background has on average over all robots is that of hardly any of them. Its error is the distance of its tool from
the model's, noise of no device in it. So the share of draws within a tolerance is the probability of being within it, at whatever
moment it is asked (Berger 1985, 7.7).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calflow.design.discrimination import rows_like
from calflow.design.planned import Planned, Task
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Regressors
from calflow.diagnosis.screening import Catalogue, Screening
from calflow.diagnosis.verdict import label
from calflow.effects import Effect
from calflow.effects.base import Cause
from calflow.estimation.calibrated_model import Alternative
from calflow.estimation.noise import PerUnit
from calflow.estimation.probing import probed
from calflow.estimation.smooth_functions import Wandering, smooth_functions
from calflow.estimation.variance_components import LOG_PRIOR, SIZES, directions, explained
from calflow.measurements.series import Series
from calflow.model import Model
from calflow.observations.position import Position

Kind = Literal["nothing", "cause", "background", "pose"]
ERROR_KINDS: tuple[Kind, ...] = ("nothing", "cause", "background", "pose")  # as likely as each other before any data
TIMES_NOISE = 2.0 ** np.arange(-3.0, 4.5, 0.5)  # sizes of a background, over the noise: from an eighth to sixteen times
SILENT = 0.98  # of a prior's variance: above, the data say nothing
TASK_DRAWS = 2000


def _device_wanders(effect: Effect) -> bool:
    return isinstance(effect, Wandering) and effect.quantity.of_device()


@dataclass(frozen=True, eq=False)
class Form:
    """A form of what may be lacking: effects at nothing, which of their columns are its own, and these' usual sizes (n,)."""

    kind: Kind
    name: str
    effects: tuple[Effect, ...]
    columns: np.ndarray
    sd: np.ndarray

    @property
    def of_robot(self) -> bool:
        """Whether it moves the tool; what only the device makes of it does not."""
        if self.kind == "background":
            return not any(_device_wanders(effect) for effect in self.effects)
        return not any(isinstance(effect, Cause) and effect.of_device() for effect in self.effects)


@dataclass(frozen=True, eq=False)
class Lack:
    """A form in one size, with its logarithmic weight: prior times likelihood; amplitudes are in units of the form's sd."""

    form: Form
    size: float
    log_weight: float

    @property
    def alone(self) -> float:
        """Size of an error of each row for itself, over the noise."""
        return self.size if self.form.kind == "pose" else 0.0


@dataclass(frozen=True, eq=False)
class Lacks:
    """What a fitted model may lack, and the linearised model beside which it was weighed, with all these effects.

    scatter is what rows err by beside all that, per axis [m].
    """

    fitted: Fitted
    effects: tuple[Effect, ...]
    regressors: Regressors[Cause]
    every: tuple[Lack, ...]
    scatter: float

    @staticmethod
    def of(fitted: Fitted, catalogue: Catalogue) -> Lacks:
        """Weigh all that a fitted model may lack beside the noise.

        A discrepancy is none of that, though it was significant: it is one of the sizes of what each pose may err by for itself.
        """
        bare = replace(fitted, background=None, noise=replace(fitted.noise, discrepancy=PerUnit()))
        kinds = [(inputs, effects) for inputs, effects in smooth_functions(bare.problem, bare.fit.estimate, bare.data)]
        smooth = [effect for _, effects in kinds for effect in effects]
        effects = (*catalogue.effects, *smooth)
        regressors = bare.regressors(effects)
        seen = Screening(regressors)
        n_smooth = sum(len(effect.declared) for effect in smooth)
        forms = [*_causes(regressors, fitted.causes, smooth), *_backgrounds(regressors, kinds, n_smooth)]
        weighed = [lack for kind in ERROR_KINDS for lack in _weighed(seen, kind, forms)]
        return Lacks(fitted, effects, regressors, tuple(weighed), bare.problem.scatter)

    @cached_property
    def weights(self) -> np.ndarray:
        """How probable each is, shape (n_lacks,)."""
        logs = np.array([lack.log_weight for lack in self.every])
        return np.asarray(np.exp(logs - scipy.special.logsumexp(logs)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the free parameters where the model lacks nothing, (n_free, n_free)."""
        return self.parameters(0.0)[1]

    def parameters(self, alone: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n_free,), from the estimate, and covariance (n_free, n_free) of the free parameters.

        alone is an error of each row for itself, over the noise.
        """
        covariance = np.linalg.inv(_information(self.regressors, 1 + alone**2))
        return -covariance @ _gradient(self.regressors, 1 + alone**2), covariance

    @cached_property
    def screening(self) -> Screening[Cause]:
        """What the data tell of any column beside the model."""
        return Screening(self.regressors)

    def amplitude(self, lack: Lack) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n,) and covariance (n, n) of a lack's amplitudes, in their own units."""
        columns, sd = lack.form.columns, lack.form.sd * lack.size
        shown = self.screening.information(columns) * np.outer(sd, sd)
        covariance = np.linalg.inv(np.eye(len(columns)) + shown)
        return -sd * (covariance @ (sd * self.screening.score[columns])), covariance * np.outer(sd, sd)

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return by how much the fit makes up for a unit of each column, (n_free, n_columns)."""
        return np.asarray(-self.covariance @ self.regressors.products.mixed[:, columns])

    def probability(self, kind: Kind, name: str = "") -> float:
        """Return how probable a kind is, or all sizes and forms of that name."""
        asked = [lack.form.kind == kind and (not name or lack.form.name == name) for lack in self.every]
        return float(self.weights[np.array(asked)].sum())


def _causes(regressors: Regressors[Cause], causes: Sequence[Cause], smooth: Sequence[Effect]) -> Iterator[Form]:
    """Every cause that the model does not have at the same place already."""
    places, decoys = {cause.place for cause in causes}, set(map(id, smooth))
    for candidate in regressors.candidates:
        cause, columns = candidate.cause, candidate.columns
        if id(cause.effect) not in decoys and cause.place not in places:
            yield Form("cause", label(cause.id, cause.joint), (cause,), columns, regressors.prior_sd[columns])


def _backgrounds(
    regressors: Regressors[Cause], kinds: Sequence[tuple[tuple[str, ...], Sequence[Effect]]], n_smooth: int
) -> Iterator[Form]:
    """Smooth functions of each input, of the noise's size over the rows; their columns are the regressors' last ones."""
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


def _weighed(seen: Screening[Cause], kind: Kind, forms: Sequence[Form]) -> Iterator[Lack]:
    """Weigh all forms of one kind: its names alike, and in each its forms and sizes."""
    nothing = Form(kind, kind, (), np.arange(0), np.zeros(0))
    if kind == "nothing":
        yield Lack(nothing, 0.0, 0.0)
    elif kind == "pose":
        for size in TIMES_NOISE:
            yield Lack(nothing, float(size), _alone(seen, float(size)) - np.log(len(TIMES_NOISE)))
    else:
        of_kind = [form for form in forms if form.kind == kind]
        names = Counter(form.name for form in of_kind)
        sizes = SIZES if kind == "cause" else TIMES_NOISE
        prior = LOG_PRIOR if kind == "cause" else np.full(len(sizes), -np.log(len(sizes)))
        for form in of_kind:
            weights = _likelihoods(seen, form, sizes) + prior - np.log(len(names) * names[form.name])
            for size, log_weight in zip(sizes, weights, strict=True):
                yield Lack(form, float(size), float(log_weight))


def _likelihoods(seen: Screening[Cause], form: Form, sizes: np.ndarray) -> np.ndarray:
    """Return the logarithms of the likelihood with a form in each size, over that without it, shape (n_sizes,)."""
    shown = seen.information(form.columns) * np.outer(form.sd, form.sd)
    fallen, narrowed = explained(*directions(shown, form.sd * seen.score[form.columns]), sizes)
    return (fallen - narrowed) / 2


def _alone(seen: Screening[Cause], size: float) -> float:
    """Return the same of an error of each row for itself, which is as if the noise were larger."""
    r, level = seen.regressors, 1 + size**2
    information, gradient = _information(r, level), _gradient(r, level)
    chi2 = float(r.residual @ r.residual / level + r.prior_rss - gradient @ np.linalg.solve(information, gradient))
    spent = len(r.residual) * np.log(level) + np.linalg.slogdet(information)[1]
    spent -= np.linalg.slogdet(_information(r, 1.0))[1]
    return float(seen.chi2 - chi2 - spent) / 2


def _information(r: Regressors[Cause], level: float) -> np.ndarray:
    """What the data, whose noise's variance is so many times larger, and the priors tell of the free parameters."""
    return np.asarray(r.products.fitted / level + np.diag(r.precision))


def _gradient(r: Regressors[Cause], level: float) -> np.ndarray:
    """The slope of half of chi² by the free parameters at the estimate."""
    return np.asarray(r.products.fitted_left / level + r.pull)


Measure = Literal["rms", "worst"]


@dataclass(frozen=True, eq=False)
class TaskError:
    """Draws (n_draws,) [m] of the tool's true error over the task: what measure says of its points.

    lacking are those of what no measuring of the same kind takes away: errors with all parameters known. left says of each draw
    by name what it lacks.
    """

    measure: Measure
    every: np.ndarray
    lacking: np.ndarray
    left: tuple[str, ...]

    def probability(self, tolerance: float) -> float:
        """Return how probable it is that the error is within a tolerance [m]."""
        return float(np.mean(self.every <= tolerance))

    def within_at_best(self, tolerance: float) -> float:
        """Return the same where all parameters were known: what more poses come to if nothing is found with them."""
        return float(np.mean(self.lacking <= tolerance))

    def quantile(self, share: float) -> float:
        """Return the error [m] below which it is with a probability."""
        return float(np.quantile(self.every, share))


@dataclass(frozen=True, eq=False)
class Site:
    """The task as the fitted model sees it: packed rows (n_conditions, n_points), and the tool's slopes there.

    slopes (n_points, 3, n_parameters) [m] are by the parameters.
    """

    fitted: Fitted
    conditions: np.ndarray
    slopes: np.ndarray

    @staticmethod
    def of(fitted: Fitted, task: Task, rng: np.random.Generator) -> Site:
        """Take the task's points, whose conditions besides readings and payload are as those of the measured rows."""
        robot, data = fitted.data.robot, fitted.data
        n = robot.n_joints
        names = np.array([*robot.payloads, ""])
        carried = np.vstack([task.conditions[n : n + len(names) - 1], 0.5 * np.ones(task.conditions.shape[1])]).argmax(
            axis=0
        )
        readings = task.conditions[:n].T
        came = rng.choice([-1.0, 1.0], readings.shape)
        conditions = rows_like(data, readings, came, list(names[carried]), rng).conditions
        return Site(fitted, conditions, fitted.model.point_jacobian(fitted.fit.estimate, conditions))

    def moved(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return by how much effects at nothing move the tool's points, (n_points, 3, n_columns) [m]."""
        model, estimate, seen = self._seen
        _, slopes = probed(seen.problem(model, estimate, self.conditions), estimate, effects)
        return np.asarray(slopes.reshape(*self.slopes.shape[:2], -1)[:, :, len(estimate) :])

    @property
    def taught(self) -> np.ndarray:
        """Orthonormal directions (3 n_points, n) in which the points move with a tool's point of which the data say nothing."""
        fit, markers = self.fitted.fit, self.fitted.data.robot.markers
        unknown = [
            k
            for k, (parameter, variance) in enumerate(zip(fit.model.parameters, np.diag(fit.covariance), strict=True))
            if parameter.part in markers and variance > SILENT * parameter.prior_sd**2
        ]
        return np.asarray(np.linalg.qr(self.slopes[:, :, unknown].reshape(3 * len(self.slopes), len(unknown)))[0])

    @property
    def _seen(self) -> tuple[Model, np.ndarray, Planned]:
        """The model as a perfect device sees it, in the measuring frame."""
        whole = self.fitted.model
        model = replace(whole, observations=(Position.planned(Series()),))
        return model, whole.handed_on(self.fitted.fit.estimate, model), Planned(model.observations[0], 1.0)

    def left(self, lacks: Lacks, forms: Sequence[Form]) -> Iterator[np.ndarray]:
        """Yield of each form what a unit of each column moves the tool after the fit has made up for it, (n_points, 3, n)."""
        free = self.slopes[:, :, np.flatnonzero(~self.fitted.fit.at_bound)]
        moved = self.moved(lacks.effects)
        for form in forms:
            yield free @ lacks.response(form.columns) + (moved[:, :, form.columns] if form.of_robot else 0.0)


def task_error(
    lacks: Lacks, rivals: Sequence[Sequence[Alternative]], site: Site, measure: Measure, rng: np.random.Generator
) -> TaskError:
    """Draw robots that the data leave possible, and measure how far the calibrated tool is off over the task.

    A tool's point of which the data say nothing, as images do, is to be taught: what that takes off is no error. rivals are what
    may be in the place of each cause that was found, one of them or none.
    """
    fitted = lacks.fitted
    lack = rng.choice(len(lacks.every), TASK_DRAWS, p=lacks.weights)
    drawn = [(lacks.every[k], np.flatnonzero(lack == k)) for k in np.unique(lack)]
    error, lacking = _beside_noise(site, lacks, drawn, rng)
    if fitted.errors.functions:
        smooth = np.isin(lack, [k for k, candidate in enumerate(lacks.every) if candidate.form.kind == "background"])
        error[smooth], lacking[smooth] = (part[smooth] for part in _smooth(site, fitted, rng))
        drawn = [(candidate, draws) for candidate, draws in drawn if candidate.form.kind != "background"]
    for others in rivals:
        of_choice = [alternative.probability for alternative in others]
        chosen = rng.choice(len(others) + 1, TASK_DRAWS, p=[*of_choice, 1 - sum(of_choice)])
        for k, other in enumerate(others):
            lacking[chosen == k] += _apart(fitted, other, site.conditions)
    forms = list({id(candidate.form): candidate.form for candidate, _ in drawn}.values())
    slopes = dict(zip(map(id, forms), site.left(lacks, forms), strict=True))
    for candidate, draws in drawn:
        shape = lacking[draws].shape
        if candidate.alone:
            lacking[draws] += candidate.alone * lacks.scatter * rng.standard_normal(shape)
        elif len(candidate.form.columns):
            mean, covariance = lacks.amplitude(candidate)
            amplitude = mean + _normal(len(draws), covariance, rng)
            lacking[draws] += np.einsum("nab,kb->kna", slopes[id(candidate.form)], amplitude, optimize=True)
    taught = site.taught
    error, lacking = (
        off - ((off.reshape(TASK_DRAWS, -1) @ taught) @ taught.T).reshape(off.shape) for off in (error, lacking)
    )
    measured = _MEASURES[measure]
    return TaskError(
        measure, measured(error + lacking), measured(lacking), tuple(lacks.every[k].form.name for k in lack)
    )


def _beside_noise(
    site: Site, lacks: Lacks, drawn: Sequence[tuple[Lack, np.ndarray]], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw errors of the parameters, and what is left where these are known (n_draws, n_points, 3) [m], without smooth errors.

    drawn are what the model lacks, and in which draws.
    """
    fitted, free = lacks.fitted, np.flatnonzero(~lacks.fitted.fit.at_bound)
    drawn_parameters, level = np.empty((TASK_DRAWS, len(free))), _levels(fitted, rng)
    for alone in {lack.alone for lack, _ in drawn}:
        joined = np.concatenate([draws for lack, draws in drawn if lack.alone == alone])
        mean, covariance = lacks.parameters(alone)
        drawn_parameters[joined] = mean + level[joined, None] * (_normal(len(joined), covariance, rng))
    error = np.einsum("nap,kp->kna", site.slopes[:, :, free], drawn_parameters, optimize=True)
    elsewhere = fitted.left_out.drawn(TASK_DRAWS, rng)
    # Nobody can tell an error of each pose from a noise that is not known.
    apart = 0.0 if fitted.noise.known else lacks.scatter
    lacking = np.hypot(apart, elsewhere)[:, None, None] * rng.standard_normal(error.shape)
    return error, lacking


def _smooth(site: Site, fitted: Fitted, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw errors of the parameters, and what is left where these are known (n_draws, n_points, 3) [m], by the error model.

    What a device wanders by moves no tool.
    """
    still = np.array([not _device_wanders(function) for function in fitted.errors.function_of], dtype=bool)
    errors = fitted.errors.only(still)
    moved = errors.at(fitted.model, fitted.fit.estimate, site.conditions).moved
    off = _normal(TASK_DRAWS, fitted.covariance - np.outer(errors.offset, errors.offset), rng)
    slopes = site.slopes - moved @ errors.slope
    left = errors.mean + rng.standard_normal((TASK_DRAWS, len(errors.sd))) @ errors.spread.T
    smooth = np.einsum("nas,ks->kna", moved, left, optimize=True)
    smooth += errors.rest * rng.standard_normal(smooth.shape)
    smooth += site.slopes @ errors.offset
    return np.einsum("nap,kp->kna", slopes, off, optimize=True), smooth


def _normal(number: int, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw so many normal vectors (number, n) about zero."""
    value, turned = np.linalg.eigh(covariance)
    return np.asarray(rng.standard_normal((number, len(value))) * np.sqrt(np.maximum(value, 0.0)) @ turned.T)


def _levels(fitted: Fitted, rng: np.random.Generator) -> np.ndarray:
    """By how much the noise may be larger than it was taken for, (n_draws,): repeats tell it by their degrees of freedom."""
    scatter = fitted.noise.scatter
    freedom = float(scatter.freedom.sum()) if scatter is not None and "repeats" in fitted.noise.sources else np.inf
    return (
        np.ones(TASK_DRAWS)
        if not np.isfinite(freedom)
        else np.sqrt(freedom / rng.chisquare(max(freedom, 1.0), TASK_DRAWS))
    )


def _apart(fitted: Fitted, other: Alternative, conditions: np.ndarray) -> np.ndarray:
    """How far another model's tool is from the calibrated one's, (n_points, 3) [m]."""
    there = replace(other.model, given=fitted.model.given).point(other.estimate, conditions)
    return there - fitted.model.point(fitted.fit.estimate, conditions)


def _rms(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((error**2).sum(axis=2).mean(axis=1)))


def _worst(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((error**2).sum(axis=2).max(axis=1)))


_MEASURES: dict[Measure, Callable[[np.ndarray], np.ndarray]] = {"rms": _rms, "worst": _worst}
