"""The points of a task: distribution of the robot's error relative to its model at each point, by posterior draws.

To each is added a draw of the model discrepancy for new poses. Images alone show no tool: then errors are those that are left once
it is taught at the measured poses, that is, without their mean there in the tool's own axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel, Quantity, Slope, points_at
from calflow.estimation.error_model import of_parameters
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations.pose import Pose
from calflow.sampling.posterior import Posterior, shifts

At = Callable[[np.ndarray], np.ndarray]  # packed rows -> errors (n_draws, n_rows, 3), or axes (n_rows, 3, 3)
# Of each marker, its points in the task and packed rows at which it is taught.
Taught = Sequence[tuple[np.ndarray, np.ndarray]]
TASK_DRAWS = 1000
PROMISED_SHARE = 0.95  # probability of the stated radius
LIKELY = 0.95  # least probability for a point to count as within tolerance


@dataclass(frozen=True, kw_only=True)
class TaskTolerances:
    """The tolerances of a task's positions [m] and orientations [rad], None for none, and whether its points are a path."""

    tolerance: float | None = None
    turn_tolerance: float | None = None
    in_order: bool = False

    @property
    def anything(self) -> bool:
        return self.tolerance is not None or self.turn_tolerance is not None


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Draws of a robot's errors of position [m] and orientation [rad] at a task's points, (2, n_draws, n_points, 3) each.

    drawn: due to the parameters; lacking: model discrepancy, independent at each point; alike: the same discrepancy,
    perfectly correlated over all points.
    """

    drawn: np.ndarray
    lacking: np.ndarray
    alike: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Draws of the error, shape (2, n_draws, n_points, 3)."""
        return self.drawn + self.lacking

    @property
    def expected(self) -> np.ndarray:
        """Mean norm of the errors at each point, shape (2, n_points)."""
        return np.linalg.norm(self.errors, axis=3).mean(axis=1)

    @property
    def sd(self) -> np.ndarray:
        """Root mean square error about the model's prediction at each point by axis, shape (2, n_points, 3)."""
        return np.sqrt((self.errors**2).mean(axis=1))

    @property
    def radius(self) -> np.ndarray:
        """Quantile PROMISED_SHARE of the errors' norm at each point, shape (2, n_points)."""
        return np.quantile(np.linalg.norm(self.errors, axis=3), PROMISED_SHARE, axis=1)

    def within(self, asked: TaskTolerances, alike: bool = False) -> np.ndarray:
        """Return whether each draw of each point meets all tolerances required, shape (n_draws, n_points)."""
        limits = np.array([np.inf if limit is None else limit for limit in (asked.tolerance, asked.turn_tolerance)])
        errors = self.drawn + (self.alike if alike else self.lacking)
        return np.asarray((np.linalg.norm(errors, axis=3) < limits[:, None, None]).all(axis=0))

    def likely(self, asked: TaskTolerances) -> int | None:
        """Return the number of points that meet the tolerances with probability LIKELY or more; None without any."""
        return int((self.within(asked).mean(axis=0) >= LIKELY).sum()) if asked.anything else None


def taught(calibrated: CalibratedModel, task: Measurements, measured: Measurements) -> Taught:
    """Return where each marker of a task is taught: at the measured poses, where images alone were measured; else nowhere."""
    if not calibrated.model.tool_unseen:
        return ()
    poses = measured.table.drop_duplicates(["pose", "payload"])
    markers = task.table["marker"].to_numpy()
    return [
        (
            np.flatnonzero(markers == marker),
            replace(measured, table=poses.assign(marker=marker)).stating(calibrated.model.given).conditions,
        )
        for marker in dict.fromkeys(markers)
    ]


def _untaught(errors: At, axes: At, conditions: np.ndarray, places: Taught) -> np.ndarray:
    """Return errors (n_draws, n_points, 3) at packed rows without their mean, in the tool's axes, where it is taught."""
    here, turned = errors(conditions), axes(conditions) if places else np.zeros(0)
    for points, rows in places:
        mean = np.einsum("nji,dnj->di", axes(rows), errors(rows)) / rows.shape[1]
        here[:, points] -= np.einsum("nij,dj->dni", turned[points], mean)
    return here


def point_errors(
    posterior: Posterior,
    calibrated: CalibratedModel,
    conditions: np.ndarray,
    rng: np.random.Generator,
    widened: float = 0.0,
    places: Taught = (),
) -> PointErrors:
    """Return draws of the robot's errors at a task's points, relative to the fitted model.

    Args:
        posterior: the sampled posterior.
        calibrated: the full model, causes held during sampling included, for the conditions that the rows state.
        conditions: packed conditions (n_conditions, n_points).
        rng: random numbers.
        widened: further variance of positions [m²].
        places: where the tool is taught, if nothing measured shows it.
    """
    lean = posterior.calibrated.later(calibrated.model.given)
    draws, acts = posterior.drawn(TASK_DRAWS, rng)
    factor = np.exp(2 * draws[:, -1])[:, None, None]  # of the noise's variance

    def errors(
        quantity_at: Callable[[np.ndarray], Quantity], axes: At, slope: Slope, left: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        def drawn(rows: np.ndarray) -> np.ndarray:
            quantity = quantity_at(rows)
            here = quantity(lean.model, lean.estimate)
            off = np.array([quantity(lean.model, draw) for draw in draws[:, :-1]]) - here
            return np.asarray(off + shifts(lean, acts, quantity))

        off = _untaught(drawn, axes, conditions, places)
        size = np.sqrt(left + _held(calibrated, lean, conditions, slope))
        alike = rng.standard_normal((len(off), 1, 3))
        return off, size * rng.standard_normal(off.shape), size * alike

    position = errors(
        points_at,
        lambda rows: lean.model.rotation(lean.estimate, rows),
        Model.point_jacobian,
        factor * calibrated.left_variance(conditions) + widened,
    )
    turn = errors(
        lambda rows: _turn_from(calibrated, rows),
        lambda rows: np.tile(np.eye(3), (rows.shape[1], 1, 1)),
        Model.rotation_jacobian,
        factor * calibrated.rotation_variances(conditions)[1],
    )
    return PointErrors(*map(np.stack, zip(position, turn, strict=True)))


def _turn_from(calibrated: CalibratedModel, conditions: np.ndarray) -> Quantity:
    """Return the small rotation of a model's tool relative to the fitted one's, about its own axes (n_points, 3) [rad]."""
    fitted = calibrated.model.rotation(calibrated.estimate, conditions)

    def turn(model: Model, estimate: np.ndarray) -> np.ndarray:
        apart = np.einsum("nji,njk->nik", fitted, model.rotation(estimate, conditions))
        return 0.5 * np.stack(
            [apart[:, 2, 1] - apart[:, 1, 2], apart[:, 0, 2] - apart[:, 2, 0], apart[:, 1, 0] - apart[:, 0, 1]], axis=1
        )

    return turn


def _held(calibrated: CalibratedModel, lean: CalibratedModel, conditions: np.ndarray, slope: Slope) -> np.ndarray:
    """Return the variance (n_points, 3) due to parameters held at their estimates during sampling."""
    total = of_parameters(slope(calibrated.model, calibrated.estimate, conditions), calibrated.covariance)
    return np.maximum(total - of_parameters(slope(lean.model, lean.estimate, conditions), lean.covariance), 0.0)


@dataclass(frozen=True, kw_only=True)
class TaskPoint:
    """A point of the task: the tool's position predicted by the calibrated model, and the distribution of its error."""

    point: str = column("name in the task's file, else a number")
    payload: str = column("the robot's payload")
    marker: str = column("the marker predicted")
    x_mm: float = column("position predicted by the model, along the measuring frame's x", "mm")
    y_mm: float = column("the same along y", "mm")
    z_mm: float = column("the same along z", "mm")
    nominal_mm: float = column(
        "distance of the nominal robot's prediction from it: the error without calibration", "mm"
    )
    expected_mm: float = column("mean of the remaining error", "mm")
    sd: Mapping[str, float] = column(
        "root mean square of that error along the measuring frame's axes", "mm", name="sd_{x|y|z}_mm"
    )
    radius95_mm: float = column("95 % quantile of the error", "mm")
    turn_mrad: float = column("mean orientation error of the tool relative to the model", "mrad")
    sd_turn: Mapping[str, float] = column(
        "root mean square of that error about the tool's own axes", "mrad", name="sd_turn_{x|y|z}_mrad"
    )
    turn95_mrad: float = column("95 % quantile of the orientation error", "mrad")
    within: float = column("probability that the point meets the tolerances; empty: none stated")
    beyond: str = column("joints outside their measured range, and a payload that was not measured; empty: none")


@dataclass(frozen=True, kw_only=True)
class TaskSummary:
    """The predicted accuracy of the robot over the whole task."""

    points: int = column("number of points of the task, under all its payloads")
    in_order: bool = column("whether they are a path, in the order of their rows")
    tolerance_mm: float | None = column("tolerance of the position; null: none", "mm")
    turn_tolerance_mrad: float | None = column("tolerance of the orientation; null: none", "mrad")
    nominal_mm: float = column("mean error of the nominal robot", "mm")
    expected_mm: float = column("mean remaining error", "mm")
    worst_radius95_mm: float = column("largest 95 % radius of the points", "mm")
    worst_turn95_mrad: float = column("largest 95 % angle of the points", "mrad")
    likely_points: int | None = column(
        "points that meet the tolerances with at least 95 % probability; null: no tolerance"
    )
    likely_positions: int | None = column("points whose position alone does; null: no such tolerance")
    likely_turns: int | None = column("points whose orientation alone does; null: no such tolerance")
    orientation_measured: bool = column("whether any orientation was measured; else orientation errors rest on priors")
    least_within: float | None = column("smallest probability of a point; null: no tolerance")
    all_within: float | None = column(
        "probability that all points meet the tolerances if the model discrepancy is independent between poses; null: no tolerance"
    )
    all_within_alike: float | None = column(
        "the same if the discrepancy is common to all poses: the truth is between the two; null: no tolerance"
    )
    beyond_measured: int = column("points outside the measured range of joints or payloads")
    notes: tuple[str, ...] = column("remarks on the interpretation of these figures", default=())


def task_table(
    calibrated: CalibratedModel,
    task: Measurements,
    measured: Measurements,
    errors: PointErrors,
    asked: TaskTolerances,
    places: Taught = (),
) -> pd.DataFrame:
    """Return a table with one row (`TaskPoint`) per point of the task; measured: the fitted rows; places: see `point_errors`."""
    model, place = calibrated.model, calibrated.expected_point(task.conditions)

    def nominal(rows: np.ndarray) -> np.ndarray:
        return (model.point(model.nominal, rows) - calibrated.expected_point(rows))[None]

    (off,) = _untaught(nominal, lambda rows: model.rotation(model.nominal, rows), task.conditions, places)
    within = errors.within(asked).mean(axis=0) if asked.anything else np.nan
    (sd, sd_turn), (expected, turn), (radius, turn95) = errors.sd, errors.expected, errors.radius
    by_axis = [("{}_mm", place), ("sd_{}_mm", sd), ("sd_turn_{}_mrad", sd_turn)]
    table = task.table[["payload", "marker"]].assign(
        point=task.table["pose"],
        **{name.format(axis): 1e3 * values[:, k] for name, values in by_axis for k, axis in enumerate("xyz")},
        nominal_mm=1e3 * np.linalg.norm(off, axis=1),
        expected_mm=1e3 * expected, radius95_mm=1e3 * radius, turn_mrad=1e3 * turn, turn95_mrad=1e3 * turn95,
        within=within, beyond=_unmeasured(calibrated, task, measured),
    )  # fmt: skip
    return typed(table, TaskPoint)


def task_summary(
    calibrated: CalibratedModel, table: pd.DataFrame, errors: PointErrors, asked: TaskTolerances, notes: tuple[str, ...]
) -> TaskSummary:
    """Return the predicted accuracy over the whole task."""
    together = [
        float(errors.within(asked, alike).all(axis=1).mean()) if asked.anything else None for alike in (False, True)
    ]
    return TaskSummary(
        points=len(table), in_order=asked.in_order,
        tolerance_mm=None if asked.tolerance is None else 1e3 * asked.tolerance,
        turn_tolerance_mrad=None if asked.turn_tolerance is None else 1e3 * asked.turn_tolerance,
        nominal_mm=table["nominal_mm"].mean(), expected_mm=table["expected_mm"].mean(),
        worst_radius95_mm=table["radius95_mm"].max(), worst_turn95_mrad=table["turn95_mrad"].max(),
        likely_points=errors.likely(asked), likely_positions=errors.likely(replace(asked, turn_tolerance=None)),
        likely_turns=errors.likely(replace(asked, tolerance=None)),
        orientation_measured=calibrated.model.tool_unseen
        or any(isinstance(seen, Pose) for seen in calibrated.model.observations),
        least_within=float(table["within"].min()) if asked.anything else None,
        all_within=together[0], all_within_alike=together[1],
        beyond_measured=int((table["beyond"] != "").sum()), notes=notes,
    )  # fmt: skip


def _unmeasured(calibrated: CalibratedModel, task: Measurements, measured: Measurements) -> list[str]:
    """Return for each point, in words, joints outside their measured range and a payload that was not measured."""
    outside = calibrated.beyond_range(task.joints)
    carried = set(measured.table["payload"])
    joints = [", ".join(f"joint {i + 1}" for i in np.flatnonzero(row)) for row in outside]
    loads = ["" if payload in carried else f"payload {payload or 'none'}" for payload in task.table["payload"]]
    return ["; ".join(filter(None, pair)) for pair in zip(joints, loads, strict=True)]
