"""The task's error: how far off its model a robot may be where it works, by draws of the posterior.

Draws of the parameters, and of the causes that explain the data as well, go through the graph; what the model lacks beside its
parameters is added to each, as large as the fit found it at poses that it had not seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calflow.estimation.calibrated import Identified
from calflow.estimation.certainty import left_variance, of_parameters
from calflow.model import Model
from calflow.sampling.sample import Sampled

Asked = Callable[[Model, np.ndarray, np.ndarray], np.ndarray]  # of a model at an estimate, of packed rows
DRAWS = 1000
SURE = 0.95  # of the errors are below what is promised


@dataclass(frozen=True, eq=False)
class Spread:
    """Errors of one kind at a task's points [m, or rad].

    drawn (n_draws, n_points, 3) are those of the parameters, own (n_draws, n_points, 3) what the model errs by beside them, at each
    point for itself, alike (n_draws, n_points, 3) the same where it is one error at all points.
    """

    drawn: np.ndarray
    own: np.ndarray
    alike: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Draws of the error, shape (n_draws, n_points, 3)."""
        return self.drawn + self.own

    @property
    def lengths(self) -> np.ndarray:
        """Draws of its length, shape (n_draws, n_points)."""
        return np.linalg.norm(self.errors, axis=2)

    @property
    def expected(self) -> np.ndarray:
        """Mean length at each point, shape (n_points,)."""
        return self.lengths.mean(axis=0)

    @property
    def sd(self) -> np.ndarray:
        """Root mean square at each point by axis, about what the model says, shape (n_points, 3)."""
        return np.sqrt((self.errors**2).mean(axis=0))

    @property
    def radius(self) -> np.ndarray:
        """The length below which the error is with a probability of SURE, shape (n_points,)."""
        return np.quantile(self.lengths, SURE, axis=0)

    def within(self, tolerance: float, alike: bool = False) -> np.ndarray:
        """Return in which draws the error at each point is below a tolerance, shape (n_draws, n_points)."""
        errors = self.drawn + (self.alike if alike else self.own)
        return np.asarray(np.linalg.norm(errors, axis=2) < tolerance)


@dataclass(frozen=True, eq=False)
class TaskError:
    """What a calibrated robot may err by at a task's points: positions [m] and orientations [rad]."""

    position: Spread
    turn: Spread

    def within(self, tolerance: float | None, turn_tolerance: float | None, alike: bool = False) -> np.ndarray:
        """Return in which draws each point meets all tolerances that are asked, shape (n_draws, n_points)."""
        met = np.full(self.position.drawn.shape[:2], True)
        if tolerance is not None:
            met &= self.position.within(tolerance, alike)
        if turn_tolerance is not None:
            met &= self.turn.within(turn_tolerance, alike)
        return met


def task_error(
    sampled: Sampled, known: Identified, rows: np.ndarray, rng: np.random.Generator, widened: float = 0.0
) -> TaskError:
    """Return what draws say of the robot's errors at a task's points, against the model as it was fitted.

    Args:
        sampled: the posterior.
        known: the whole model, of which sampled may hold some causes at their estimates, for conditions that the rows state.
        rows: packed conditions (n_conditions, n_points).
        rng: draws.
        widened: further variance of positions [m²].
    """
    lean = replace(sampled.known, model=replace(sampled.known.model, given=known.model.given))
    flat = sampled.values.reshape(-1, sampled.values.shape[-1])
    draws = flat[rng.choice(len(flat), size=min(DRAWS, len(flat)), replace=False)]
    chosen = rng.random((len(draws), len(known.alternatives))) < [one.probability for one in known.alternatives]
    factor = np.exp(2 * draws[:, -1])[:, None, None]  # of the noise's variance

    def spread(asked: Asked, slope: Asked, left: np.ndarray) -> Spread:
        here = asked(known.model, known.estimate, rows)
        drawn = np.array([asked(lean.model, draw[:-1], rows) for draw in draws]) - here
        for one, own in zip(known.alternatives, chosen.T, strict=True):
            other = asked(replace(one.model, given=known.model.given), one.estimate, rows)
            drawn += own[:, None, None] * (other - here)
        size = np.sqrt(left + _held(known, lean, rows, slope))
        alike = rng.standard_normal((len(draws), 1, 3))
        return Spread(drawn, size * rng.standard_normal(drawn.shape), size * alike)

    return TaskError(
        spread(Model.point, Model.point_jacobian, factor * left_variance(known, rows) + widened),
        spread(_turn_from(known, rows), Model.rotation_jacobian, factor * known.rotation_discrepancy**2),
    )


def _turn_from(known: Identified, rows: np.ndarray) -> Asked:
    """Return how a model's tool is turned from the fitted one's, about its own axes (n_points, 3) [rad]; small."""
    fitted = known.model.rotation(known.estimate, rows)

    def turn(model: Model, estimate: np.ndarray, of: np.ndarray) -> np.ndarray:
        apart = np.einsum("nji,njk->nik", fitted, model.rotation(estimate, of))
        return 0.5 * np.stack([apart[:, 2, 1] - apart[:, 1, 2], apart[:, 0, 2] - apart[:, 2, 0],
                               apart[:, 1, 0] - apart[:, 0, 1]], axis=1)  # fmt: skip

    return turn


def _held(known: Identified, lean: Identified, rows: np.ndarray, slope: Asked) -> np.ndarray:
    """Variance (n_points, 3) of what was held at its estimate while the rest was sampled."""
    if len(known.estimate) == len(lean.estimate):
        return np.zeros((rows.shape[1], 3))
    whole = of_parameters(slope(known.model, known.estimate, rows), known.covariance)
    return np.maximum(whole - of_parameters(slope(lean.model, lean.estimate, rows), lean.covariance), 0.0)
