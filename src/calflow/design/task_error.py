"""The posterior of the calibrated tool's error over its task, with what the model may lack though unproven.

A draw is a robot compatible with the data: with one cause that the model lacks, by the probability of its place, or none; smooth
errors, of sizes drawn from their posterior; an independent error of each pose; the rivals in the causes' places; and the excess
error of poses left out in turn (see `LeftOut`). The share of draws within a tolerance is the probability of meeting it, at any
stopping time (Berger 1985, 7.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.design.discrimination import rows_like
from calflow.design.planned import Measure, Planned, Task, by_tool
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue, by_place, place_probabilities
from calflow.diagnosis.trial import Linearisation
from calflow.effects.cause import Cause
from calflow.estimation.calibrated_model import Alternative, offsets, points_at
from calflow.estimation.error_model import VISIBLE, ErrorModel
from calflow.estimation.probing import probed
from calflow.estimation.smooth_functions import Wandering
from calflow.estimation.variance_components import SIZES
from calflow.files.units import METRE
from calflow.measurements.series import Series
from calflow.model import consecutive
from calflow.observations.position import Position

UNINFORMATIVE = 0.98  # posterior over prior variance above which the data are uninformative
TASK_DRAWS, SIZE_DRAWS = 2000, 50  # draws, and different sizes of the smooth errors among them


@dataclass(frozen=True, eq=False)
class LackingCause:
    """A cause that the model may lack: the likeliest form at its place, with the place's probability.

    sizes (n_sizes,): posterior probabilities of its sizes; mean (n_sizes, n), covariance (n_sizes, n, n): of its parameters by
    size; response (n_free, n): change of the fitted parameters by a unit of each.
    """

    cause: Cause
    probability: float
    sizes: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    response: np.ndarray

    @property
    def root(self) -> np.ndarray:
        """A root R (n, n) of its parameters' second moment R Rᵀ."""
        second = self.mean[:, :, None] * self.mean[:, None, :] + self.covariance
        return np.linalg.cholesky(np.tensordot(self.sizes, second, 1))

    def drawn(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw its parameters (number, n)."""
        size = rng.choice(len(self.sizes), number, p=self.sizes)
        spread = np.linalg.cholesky(self.covariance)[size] @ rng.standard_normal((number, self.mean.shape[1], 1))
        return np.asarray(self.mean[size] + spread[:, :, 0])


def lacking_causes(fitted: Fitted, catalogue: Catalogue) -> tuple[LackingCause, ...]:
    """Return the causes that a fitted model may lack, one at a time."""
    linear = Linearisation.at(fitted, catalogue.effects)
    places, whole = by_place(linear.beside.scores), linear.whole
    likely, best = place_probabilities(places), {place: score.candidate for place, (_, score) in places.items()}
    return tuple(
        LackingCause(one.cause, likely[place], *whole.amplitudes(one.columns), whole.imitation(one.columns))
        for place, one in best.items()
    )


def of_robot(errors: ErrorModel) -> ErrorModel:
    """Return the errors that move the tool, unlike a drift of the measuring set-up."""
    return errors.only(lambda function: not (isinstance(function, Wandering) and function.quantity.of_measuring()))


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

    @property
    def taught(self) -> np.ndarray:
        """Orthonormal displacements (3 n_points, n) by coordinates of the tool point that the data do not determine."""
        fit, markers, model = self.fitted.fit, self.fitted.data.robot.markers, self.fitted.model
        if model.tool_unseen:
            return by_tool(model, fit.estimate, self.conditions)
        of_marker = np.array([parameter.part in markers for parameter in fit.model.parameters])
        unknown = of_marker & (np.diag(fit.covariance) > UNINFORMATIVE * fit.model.prior_sd**2)
        return np.asarray(np.linalg.qr(self.slopes[:, :, unknown].reshape(3 * len(self.slopes), -1))[0])

    def by(self, causes: Sequence[LackingCause]) -> list[np.ndarray]:
        """Return for each cause the tool's displacement by a unit of each of its parameters, after refitting, (n_points, 3, n)."""
        whole, perfect = self.fitted.model, Planned(Position.planned(Series()), 1.0)
        model = replace(whole, observations=(perfect.observation,))
        estimate = whole.handed_on(self.fitted.fit.estimate, model)
        effects = tuple(cause.cause for cause in causes)
        _, slopes = probed(perfect.problem(model, estimate, self.conditions), estimate, effects)
        moved = slopes.reshape(*self.slopes.shape[:2], -1)[:, :, len(estimate) :]
        free = self.slopes[:, :, np.flatnonzero(~self.fitted.fit.at_bound)]
        own = consecutive(cause.response.shape[1] for cause in causes)
        return [
            free @ cause.response + (0.0 if cause.cause.of_measuring() else moved[:, :, span])
            for cause, span in zip(causes, own, strict=True)
        ]


def task_error(
    fitted: Fitted,
    causes: Sequence[LackingCause],
    rivals: Sequence[Sequence[Alternative]],
    at_task: TaskSlopes,
    measure: Measure,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return posterior draws (n_draws,) [m] of the calibrated tool's true error over the task: root mean square or worst point.

    The second are the same with all parameters known, which no further measurement of this kind reduces. A tool point that the
    data do not determine, as with images, must be taught: errors that teaching removes do not count. Of causes that the model may
    lack, and of the rivals of each one found, one or none is there.
    """
    likely = np.array([cause.probability for cause in causes])
    drawn = rng.choice(len(causes) + 1, TASK_DRAWS, p=[*likely, 1 - likely.sum()])
    # A misfit is a cause, smooth with an independent part of its own, or independent, and hardly ever two of these.
    variances = fitted.smooth.drawn(SIZE_DRAWS, rng)[np.arange(TASK_DRAWS) % SIZE_DRAWS]
    variances[drawn < len(causes)] = 0.0
    error, lacking = np.empty((2, TASK_DRAWS, len(at_task.slopes), 3))
    for variance in np.unique(variances, axis=0):
        draws = np.flatnonzero((variances == variance).all(axis=1))
        error[draws], lacking[draws] = _drawn(at_task, variance, len(draws), rng)
    sizes, probable = independent_sizes(fitted)
    independent, excess = rng.choice(sizes, TASK_DRAWS, p=probable), fitted.left_out.drawn(TASK_DRAWS, rng)
    independent[drawn < len(causes)] = 0.0
    independent, excess = np.where(variances.any(axis=1), 0.0, (independent, excess))
    error *= (_noise_levels(fitted, rng) * np.hypot(1.0, independent))[:, None, None]
    alone = np.hypot(excess, independent * fitted.problem.scatter())
    lacking += alone[:, None, None] * rng.standard_normal(lacking.shape)
    for others in rivals:
        of_choice = [alternative.probability for alternative in others]
        chosen = rng.choice(len(others) + 1, TASK_DRAWS, p=[*of_choice, 1 - sum(of_choice)])
        moved = offsets(others, fitted.model, fitted.fit.estimate, points_at(at_task.conditions))
        for k in range(len(others)):
            lacking[chosen == k] += moved[:, :, k]
    there = np.unique(drawn[drawn < len(causes)])
    for k, moved in zip(there, at_task.by([causes[k] for k in there]), strict=True):
        draws = np.flatnonzero(drawn == k)
        lacking[draws] += np.einsum("nab,kb->kna", moved, causes[k].drawn(len(draws), rng))
    taught = at_task.taught
    error, lacking = (
        off - ((off.reshape(TASK_DRAWS, -1) @ taught) @ taught.T).reshape(off.shape) for off in (error, lacking)
    )
    return _size(error + lacking, measure), _size(lacking, measure)


def _drawn(
    at_task: TaskSlopes, variance: np.ndarray, number: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw errors by parameters and errors with parameters known, (number, n_points, 3) [m], with smooth ones of a variance."""
    covariance, every = at_task.fitted.with_smooth_errors(variance)
    errors = of_robot(every)
    moved = errors.moved(at_task.fitted.model, at_task.fitted.fit.estimate, at_task.conditions)
    shared = errors.shared(np.concatenate([at_task.slopes, moved], axis=2), covariance)
    mean, of_parameters, alone = np.split(shared, [1, 1 + len(covariance)], axis=2)
    drawn = rng.standard_normal((number, len(covariance) + len(errors.sd)))
    error = np.einsum("nap,kp->kna", of_parameters, drawn[:, : len(covariance)], optimize=True)
    smooth = mean[:, :, 0] + np.einsum("nas,ks->kna", alone, drawn[:, len(covariance) :], optimize=True)
    return error, smooth + errors.rest[METRE] * rng.standard_normal(smooth.shape)


def _noise_levels(fitted: Fitted, rng: np.random.Generator) -> np.ndarray:
    """Draw the ratio of true to assumed noise, (TASK_DRAWS,), by the degrees of freedom of the repeats."""
    scatter = fitted.noise.scatter
    freedom = float(scatter.freedom.sum()) if scatter is not None and "repeats" in fitted.noise.sources else np.inf
    if not np.isfinite(freedom):
        return np.ones(TASK_DRAWS)
    return np.asarray(np.sqrt(freedom / rng.chisquare(max(freedom, 1.0), TASK_DRAWS)))


def independent_sizes(fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Return sizes of an independent error of each pose over a known noise, none first, as likely, and their probabilities."""
    if not fitted.noise.known:
        return np.zeros(1), np.ones(1)
    sizes, residual = np.append(0.0, SIZES[SIZES**2 > VISIBLE]), fitted.alone.residual
    freedom, larger = residual.size - fitted.fit.effective_parameters, 1 + sizes**2
    log_likelihood = -(freedom * np.log(larger) + residual @ residual / larger) / 2
    log_prior = np.where(sizes > 0, 0.0, np.log(len(sizes) - 1))
    return sizes, np.asarray(scipy.special.softmax(log_likelihood + log_prior))


def _size(error: np.ndarray, measure: Measure) -> np.ndarray:
    squared = (error**2).sum(axis=2)
    return np.asarray(np.sqrt(squared.max(axis=1) if measure == "worst" else squared.mean(axis=1)))
