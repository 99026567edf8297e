"""The points of a task: how far off its model a robot may be at each of them, by draws of the posterior.

Draws of the parameters, and of the causes that explain the data as well, go through the graph; what the model lacks beside its
parameters is added to each, as large as the fit found it at poses that it had not seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel, expected_point, left_variance
from calflow.estimation.error_model import of_parameters
from calflow.estimation.leverage import beyond
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame
from calflow.files.units import RADIAN
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations.pose import Pose
from calflow.sampling.posterior import Posterior, PosteriorDraws, Quantity

Slope = Callable[[Model, np.ndarray, np.ndarray], np.ndarray]  # of a model at an estimate, of packed rows
DRAWS = 1000
SURE = 0.95  # of the errors are below what is promised


@dataclass(frozen=True, eq=False)
class ErrorDraws:
    """Errors of one kind at a task's points [m, or rad].

    drawn (n_draws, n_points, 3) are those of the parameters, lacking (n_draws, n_points, 3) what the model errs by beside them, at
    each point for itself, alike (n_draws, n_points, 3) the same where it is one error at all points.
    """

    drawn: np.ndarray
    lacking: np.ndarray
    alike: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Draws of the error, shape (n_draws, n_points, 3)."""
        return self.drawn + self.lacking

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
        errors = self.drawn + (self.alike if alike else self.lacking)
        return np.asarray(np.linalg.norm(errors, axis=2) < tolerance)


@dataclass(frozen=True, eq=False)
class PointErrors:
    """What a calibrated robot may err by at a task's points: positions [m] and orientations [rad]."""

    position: ErrorDraws
    turn: ErrorDraws

    def within(self, tolerance: float | None, turn_tolerance: float | None, alike: bool = False) -> np.ndarray:
        """Return in which draws each point meets all tolerances that are asked, shape (n_draws, n_points)."""
        met = np.full(self.position.drawn.shape[:2], True)
        if tolerance is not None:
            met &= self.position.within(tolerance, alike)
        if turn_tolerance is not None:
            met &= self.turn.within(turn_tolerance, alike)
        return met


def point_errors(
    posterior: Posterior,
    calibrated: CalibratedModel,
    conditions: np.ndarray,
    rng: np.random.Generator,
    widened: float = 0.0,
) -> PointErrors:
    """Return what draws say of the robot's errors at a task's points, against the model as it was fitted.

    Args:
        posterior: the sampled one.
        calibrated: the whole model, of which the posterior may hold some causes at their estimates, for conditions that the rows
            state.
        conditions: packed conditions (n_conditions, n_points).
        rng: draws.
        widened: further variance of positions [m²].
    """
    lean = replace(posterior.calibrated, model=replace(posterior.calibrated.model, given=calibrated.model.given))
    draws = replace(PosteriorDraws.of(posterior, DRAWS, rng), calibrated=lean)
    factor = np.exp(2 * draws.values[:, -1])[:, None, None]  # of the noise's variance

    def errors(quantity: Quantity, slope: Slope, left: np.ndarray) -> ErrorDraws:
        here = quantity(lean.model, lean.estimate)
        drawn = np.array([quantity(lean.model, draw) for draw in draws.values[:, :-1]]) - here + draws.shifts(quantity)
        size = np.sqrt(left + _held(calibrated, lean, conditions, slope))
        alike = rng.standard_normal((len(drawn), 1, 3))
        return ErrorDraws(drawn, size * rng.standard_normal(drawn.shape), size * alike)

    return PointErrors(
        errors(
            lambda model, p: model.point(p, conditions),
            Model.point_jacobian,
            factor * left_variance(calibrated, conditions) + widened,
        ),
        errors(
            _turn_from(calibrated, conditions), Model.rotation_jacobian, factor * calibrated.discrepancy[RADIAN] ** 2
        ),
    )


def _turn_from(calibrated: CalibratedModel, conditions: np.ndarray) -> Quantity:
    """Return how a model's tool is turned from the fitted one's, about its own axes (n_points, 3) [rad]; small."""
    fitted = calibrated.model.rotation(calibrated.estimate, conditions)

    def turn(model: Model, estimate: np.ndarray) -> np.ndarray:
        apart = np.einsum("nji,njk->nik", fitted, model.rotation(estimate, conditions))
        return 0.5 * np.stack(
            [apart[:, 2, 1] - apart[:, 1, 2], apart[:, 0, 2] - apart[:, 2, 0], apart[:, 1, 0] - apart[:, 0, 1]], axis=1
        )

    return turn


def _held(calibrated: CalibratedModel, lean: CalibratedModel, conditions: np.ndarray, slope: Slope) -> np.ndarray:
    """Variance (n_points, 3) of what was held at its estimate while the rest was sampled."""
    if len(calibrated.estimate) == len(lean.estimate):
        return np.zeros((conditions.shape[1], 3))
    whole = of_parameters(slope(calibrated.model, calibrated.estimate, conditions), calibrated.covariance)
    return np.maximum(whole - of_parameters(slope(lean.model, lean.estimate, conditions), lean.covariance), 0.0)


LIKELY = 0.95  # probability from which a point counts as within


@dataclass(frozen=True, kw_only=True)
class TaskPoint:
    """A point of the task: where the calibrated robot says its tool is, and how far off it may be."""

    point: str = column("as in the task's file; else a number")
    payload: str = column("what the robot carries")
    marker: str = column("whose position it is")
    x_mm: float = column("where the model says it is, in the measuring frame", "mm")
    y_mm: float = column("the same along y", "mm")
    z_mm: float = column("the same along z", "mm")
    nominal_mm: float = column("how far from there the nominal robot says it is: the error without calibration", "mm")
    expected_mm: float = column("mean length of the error that is left", "mm")
    sd_x_mm: float = column("root mean square of that error along the measuring frame's x", "mm")
    sd_y_mm: float = column("the same along y", "mm")
    sd_z_mm: float = column("the same along z", "mm")
    radius95_mm: float = column("length below which the error is with 95 % probability", "mm")
    turn_mrad: float = column("mean angle by which the tool is turned otherwise than the model says", "mrad")
    sd_turn_x_mrad: float = column("root mean square of that turn about the tool's own x", "mrad")
    sd_turn_y_mrad: float = column("the same about y", "mrad")
    sd_turn_z_mrad: float = column("the same about z", "mrad")
    turn95_mrad: float = column("angle below which it is with 95 % probability", "mrad")
    within: float = column("probability that the point meets the tolerances; empty: none was asked")
    beyond: str = column("what of it is not like anything that was measured: joints, payload; empty: nothing")


@dataclass(frozen=True, kw_only=True)
class TaskSummary:
    """How accurate the robot is where it works."""

    points: int = column("of the task, under all its payloads")
    in_order: bool = column("whether they are a path, in the order of their rows")
    tolerance_mm: float | None = column("asked of the position; null: none", "mm")
    turn_tolerance_mrad: float | None = column("asked of the orientation; null: none", "mrad")
    nominal_mm: float = column("mean error of the nominal robot", "mm")
    expected_mm: float = column("mean error that is left", "mm")
    worst_radius95_mm: float = column("the largest of the points' 95 % radii", "mm")
    worst_turn95_mrad: float = column("the largest of the points' 95 % angles", "mrad")
    likely_points: int | None = column(
        "points that meet the tolerances with at least 95 % probability; null: none asked"
    )
    likely_positions: int | None = column("points whose position alone does; null: none asked of it")
    likely_turns: int | None = column("points whose orientation alone does; null: none asked of it")
    orientation_measured: bool = column(
        "whether any orientation was measured; else turns are as sure as their priors say"
    )
    least_within: float | None = column("the least probability of a point; null: none asked")
    all_within: float | None = column(
        "probability that all points meet the tolerances, where what the model lacks differs from pose to pose; null: none asked"
    )
    all_within_alike: float | None = column(
        "the same where what the model lacks is one error at all poses: the truth is between the two; null: none asked"
    )
    beyond_measured: int = column("points that are not like anything that was measured")
    notes: tuple[str, ...] = column("what has to be known to read all this", default=())


@dataclass(frozen=True, kw_only=True)
class TaskTolerances:
    """What is asked of a task [m, rad], None for nothing, and whether its points are a path."""

    tolerance: float | None = None
    turn_tolerance: float | None = None
    in_order: bool = False

    @property
    def anything(self) -> bool:
        """Whether there is a tolerance."""
        return self.tolerance is not None or self.turn_tolerance is not None


def task_table(
    calibrated: CalibratedModel, task: Measurements, measured: Measurements, errors: PointErrors, asked: TaskTolerances
) -> pd.DataFrame:
    """Return a row a point of the task; measured are the rows that were fitted."""
    place = expected_point(calibrated, task.conditions)
    nominal = calibrated.model.point(calibrated.model.nominal, task.conditions)
    within = errors.within(asked.tolerance, asked.turn_tolerance).mean(axis=0)
    position, turn, table = errors.position, errors.turn, task.table
    strange = _strange(task, measured)
    rows = [
        TaskPoint(
            point=str(table["pose"].iloc[k]), payload=str(table["payload"].iloc[k]), marker=str(table["marker"].iloc[k]),
            x_mm=1e3 * place[k, 0], y_mm=1e3 * place[k, 1], z_mm=1e3 * place[k, 2],
            nominal_mm=1e3 * float(np.linalg.norm(nominal[k] - place[k])),
            expected_mm=1e3 * position.expected[k], sd_x_mm=1e3 * position.sd[k, 0], sd_y_mm=1e3 * position.sd[k, 1],
            sd_z_mm=1e3 * position.sd[k, 2], radius95_mm=1e3 * position.radius[k],
            turn_mrad=1e3 * turn.expected[k], sd_turn_x_mrad=1e3 * turn.sd[k, 0], sd_turn_y_mrad=1e3 * turn.sd[k, 1],
            sd_turn_z_mrad=1e3 * turn.sd[k, 2], turn95_mrad=1e3 * turn.radius[k],
            within=float(within[k]) if asked.anything else float("nan"), beyond=strange[k],
        )
        for k in range(len(task))
    ]  # fmt: skip
    return to_frame(rows, TaskPoint)


def task_summary(
    calibrated: CalibratedModel, table: pd.DataFrame, errors: PointErrors, asked: TaskTolerances, notes: tuple[str, ...]
) -> TaskSummary:
    """Say how accurate the robot is over the whole task."""
    together = [
        float(errors.within(asked.tolerance, asked.turn_tolerance, alike).all(axis=1).mean())
        if asked.anything
        else None
        for alike in (False, True)
    ]
    return TaskSummary(
        points=len(table), in_order=asked.in_order,
        tolerance_mm=None if asked.tolerance is None else 1e3 * asked.tolerance,
        turn_tolerance_mrad=None if asked.turn_tolerance is None else 1e3 * asked.turn_tolerance,
        nominal_mm=table["nominal_mm"].mean(), expected_mm=table["expected_mm"].mean(),
        worst_radius95_mm=table["radius95_mm"].max(), worst_turn95_mrad=table["turn95_mrad"].max(),
        likely_points=int((table["within"] >= LIKELY).sum()) if asked.anything else None,
        likely_positions=_likely(errors.position, asked.tolerance), likely_turns=_likely(errors.turn, asked.turn_tolerance),
        orientation_measured=any(isinstance(seen, Pose) for seen in calibrated.model.observations),
        least_within=float(table["within"].min()) if asked.anything else None,
        all_within=together[0], all_within_alike=together[1],
        beyond_measured=int((table["beyond"] != "").sum()), notes=notes,
    )  # fmt: skip


def _likely(draws: ErrorDraws, tolerance: float | None) -> int | None:
    """How many points meet a tolerance with enough probability."""
    return None if tolerance is None else int((draws.within(tolerance).mean(axis=0) >= LIKELY).sum())


def _strange(task: Measurements, measured: Measurements) -> list[str]:
    """Say of each point what of it was not measured: joints beyond their readings, and a payload that was not carried."""
    outside = beyond(task.joints, measured.joints)
    carried = set(measured.table["payload"])
    joints = [", ".join(f"joint {i + 1}" for i in np.flatnonzero(row)) for row in outside]
    loads = ["" if payload in carried else f"payload {payload or 'none'}" for payload in task.table["payload"]]
    return ["; ".join(filter(None, pair)) for pair in zip(joints, loads, strict=True)]
