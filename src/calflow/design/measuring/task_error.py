"""The task error: how far the calibrated tool is off where it will work, as a posterior that counts all that may be wrong.

A draw is one robot that the data leave possible: its parameters, one of the things that the model may lack (see `lacks`), one of
the diagnosis' rivals in a cause's place, and what poses left out in turn show beyond all that (see `elsewhere`). Its error is the
distance of its tool from the model's, noise of no device in it. So the share of draws within a tolerance is the probability of
being within it, at whatever moment it is asked (Berger 1985, 7.7).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calflow.design.discrimination import rows_like
from calflow.design.measuring.lacks import Form, Lacks
from calflow.design.planned import Planned, Task
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects import Effect
from calflow.estimation.elsewhere import left_out
from calflow.estimation.probing import probed
from calflow.estimation.rival_models import Alternative
from calflow.files.units import METRE
from calflow.measurements.series import Series
from calflow.model import Model
from calflow.observations.position import Position

DRAWS = 2000
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
    rows: np.ndarray
    slopes: np.ndarray

    @staticmethod
    def of(fitted: Fitted, task: Task, rng: np.random.Generator) -> Site:
        """Take the task's points, whose conditions besides readings and payload are as those of the measured rows."""
        robot, data = fitted.data.robot, fitted.data
        n = robot.n_joints
        names = np.array([*robot.payloads, ""])
        carried = np.vstack([task.rows[n : n + len(names) - 1], 0.5 * np.ones(task.rows.shape[1])]).argmax(axis=0)
        readings = task.rows[:n].T
        came = rng.choice([-1.0, 1.0], readings.shape)
        rows = rows_like(data, readings, came, list(names[carried]), rng).rows
        return Site(fitted, rows, fitted.model.point_jacobian(fitted.fit.estimate, rows))

    def moved(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return by how much effects at nothing move the tool's points, (n_points, 3, n_columns) [m]."""
        model, estimate, seen = self._seen
        _, slopes = probed(seen.problem(model, estimate, self.rows), estimate, effects)
        return np.asarray(slopes.reshape(*self.slopes.shape[:2], -1)[:, :, len(estimate) :])

    @property
    def _seen(self) -> tuple[Model, np.ndarray, Planned]:
        """The model as a perfect device sees it, in the measuring frame."""
        whole = self.fitted.model
        model = replace(whole, observations=(Position.planned(Series()),))
        known = dict(zip((p.identity for p in whole.parameters), self.fitted.fit.estimate, strict=True))
        estimate = np.array([known.get(p.identity, p.nominal) for p in model.parameters])
        return model, estimate, Planned(model.observations[0], 1.0)

    def left(self, lacks: Lacks, forms: Sequence[Form]) -> Iterator[np.ndarray]:
        """Yield of each form what a unit of each column moves the tool after the fit has made up for it, (n_points, 3, n)."""
        free = self.slopes[:, :, np.flatnonzero(~self.fitted.fit.at_bound)]
        moved = self.moved(lacks.effects)
        for form in forms:
            yield free @ lacks.response(form.columns) + (moved[:, :, form.columns] if form.of_robot else 0.0)


def task_error(
    lacks: Lacks, alternatives: tuple[Alternative, ...], site: Site, measure: Measure, rng: np.random.Generator
) -> TaskError:
    """Draw robots that the data leave possible, and measure how far the calibrated tool is off over the task."""
    fitted, free = lacks.fitted, np.flatnonzero(~lacks.fitted.fit.at_bound)
    lack = rng.choice(len(lacks.every), DRAWS, p=lacks.weights)
    drawn = [(lacks.every[k], np.flatnonzero(lack == k)) for k in np.unique(lack)]
    known, level = np.empty((DRAWS, len(free))), _levels(fitted, rng)
    for alone in {one.alone for one, _ in drawn}:
        own = np.concatenate([draws for one, draws in drawn if one.alone == alone])
        mean, covariance = lacks.parameters(alone)
        known[own] = mean + level[own, None] * (_normal(len(own), covariance, rng))
    error = np.einsum("nap,kp->kna", site.slopes[:, :, free], known, optimize=True)
    elsewhere = left_out(fitted.fit, fitted.poses).drawn(DRAWS, rng)
    lacking = np.hypot(_apart_at_each_pose(fitted), elsewhere)[:, None, None] * rng.standard_normal(error.shape)
    of_choice = [one.probability for one in alternatives]
    chosen = rng.choice(len(of_choice) + 1, DRAWS, p=[*of_choice, 1 - sum(of_choice)])
    for k, other in enumerate(alternatives):
        lacking[chosen == k] += _apart(fitted, other, site.rows)
    forms = list({id(one.form): one.form for one, _ in drawn}.values())
    slopes = dict(zip(map(id, forms), site.left(lacks, forms), strict=True))
    for one, draws in drawn:
        shape = lacking[draws].shape
        if one.alone:
            lacking[draws] += one.alone * fitted.problem.scatter * rng.standard_normal(shape)
        elif len(one.form.columns):
            mean, covariance = lacks.amplitude(one)
            amplitude = mean + _normal(len(draws), covariance, rng)
            lacking[draws] += np.einsum("nab,kb->kna", slopes[id(one.form)], amplitude, optimize=True)
    measured = _MEASURES[measure]
    return TaskError(
        measure, measured(error + lacking), measured(lacking), tuple(lacks.every[k].form.name for k in lack)
    )


def _normal(number: int, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw so many normal vectors (number, n) about zero."""
    value, turned = np.linalg.eigh(covariance)
    return np.asarray(rng.standard_normal((number, len(value))) * np.sqrt(np.maximum(value, 0.0)) @ turned.T)


def _apart_at_each_pose(fitted: Fitted) -> float:
    """By how much the robot errs at each pose for itself, per axis [m]: what is significant, or cannot be told from the noise."""
    return fitted.noise.discrepancy[METRE] if fitted.noise.known else fitted.problem.scatter


def _levels(fitted: Fitted, rng: np.random.Generator) -> np.ndarray:
    """By how much the noise may be larger than it was taken for, (n_draws,): repeats tell it by their degrees of freedom."""
    scatter = fitted.noise.scatter
    freedom = float(scatter.freedom.sum()) if scatter is not None and "repeats" in fitted.noise.sources else np.inf
    return np.ones(DRAWS) if not np.isfinite(freedom) else np.sqrt(freedom / rng.chisquare(max(freedom, 1.0), DRAWS))


def _apart(fitted: Fitted, other: Alternative, rows: np.ndarray) -> np.ndarray:
    """How far another model's tool is from the calibrated one's, (n_points, 3) [m]."""
    there = replace(other.model, given=fitted.model.given).point(other.estimate, rows)
    return there - fitted.model.point(fitted.fit.estimate, rows)


def _rms(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((error**2).sum(axis=2).mean(axis=1)))


def _worst(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((error**2).sum(axis=2).max(axis=1)))


_MEASURES: dict[Measure, Callable[[np.ndarray], np.ndarray]] = {"rms": _rms, "worst": _worst}
