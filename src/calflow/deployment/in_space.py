"""Errors in space: errors of camera studies in millimetres, since pixels alone do not state the tool's error.

Measured: the distance, per image, between the camera or target pose that fits its points and the robot's. Predicted:
the uncertainty of the tool's position over the joint ranges once base and tool are taught, which images do not
determine; and the probability that the tool errs by less than that of the nominal robot, averaged over the scale of the
robot's deviations from its nominal figures (see `prior_scale`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from calflow.deployment.attained import rigid_slope
from calflow.design.candidates import candidates
from calflow.estimation.accuracy import mean_rms_max
from calflow.estimation.calibrated_model import CalibratedModel, choice_errors, points_at
from calflow.estimation.prior_scale import by_scale, strays
from calflow.files.tables import column
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model

RANGE_POSES = 200  # poses over the joint ranges
ROBOT_DRAWS = 500  # draws of the robot from its posterior
SURELY_BETTER = 0.95  # probability above which the calibrated tool counts as better
RANGES = "joint ranges"
ALONE = "hand-eye alone"
IN_SPACE = "in_space.csv"


@dataclass(frozen=True, kw_only=True)
class SpaceError:
    """The error of a model in space, in studies by cameras."""

    model: str = column(
        "what the robot has: `hand-eye alone`, as its maker says, or `hand-eye by` one of the usual methods; or effects and causes"
    )
    where: str = column("train, holdout: images; joint ranges: the tool's point, all over what joints reach")
    n: int = column("number of images, or of poses")
    mean_mm: float = column(
        "of images: mean distance from where the robot has camera or target to where the image shows it; over joint ranges, once "
        "base and tool are taught: as promised (root of the variance), of the robot as its maker says from the calibrated one",
        "mm",
    )
    rms_mm: float = column("root mean square of that", "mm")
    max_mm: float = column("the largest", "mm")
    better: float = column(
        "over joint ranges, of the calibrated robot: probability that its rms is less than that of the nominal robot",
        default=float("nan"),
    )
    rms_px: float = column("of images: root mean square reprojection error of points", "px", default=float("nan"))
    failed: str = column("why a method has no result", default="")
    method: str = column(
        "the closed-form method by which camera and target of the nominal robot are placed", default=""
    )

    @property
    def is_of_calibration(self) -> bool:
        """Whether it belongs to a calibrated model, named by its effects."""
        return self.model != ALONE and not self.method


def image_errors(model: Model, estimate: np.ndarray, data: Measurements, name: str) -> list[SpaceError]:
    """Return the errors of images in space by a model, on each split; none where no series is of images."""
    errors: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for k, observation in enumerate(model.observations):
        for split, of_split in (("train", data.train), ("holdout", data.held_out)):
            rows = np.flatnonzero(of_split & data.of_series(k))
            table, conditions = data.table.iloc[rows], data.conditions[:, rows]
            if not len(rows) or observation.lacks(table):
                continue
            miss = model.observed_error(observation, estimate, conditions, observation.reported(table))
            links = partial(model.link, p=estimate, conditions=conditions)
            apart = observation.in_space(model.values(observation, estimate), links, table, miss)
            if apart is not None:
                errors.setdefault(split, []).append((np.linalg.norm(apart, axis=1), (miss**2).sum(axis=1)))
    return [
        replace(
            _row(name, split, np.concatenate([far for far, _ in parts])),
            rms_px=float(np.sqrt(np.concatenate([squared for _, squared in parts]).mean())),
        )
        for split, parts in errors.items()
    ]


def hand_eye_errors(calibrated: CalibratedModel, data: Measurements) -> list[SpaceError]:
    """Return image errors in space of the nominal robot, with calibrated lens; camera and target by closed forms.

    None where several series, or none, are of images.
    """
    model = Model(calibrated.model.robot, (), data.given, calibrated.model.observations)
    if len(model.observations) > 1:
        return []
    fitted = data.only(data.train)
    links = partial(model.link, p=model.nominal, conditions=fitted.conditions)
    rows = []
    values = calibrated.model.values(calibrated.model.observations[0], calibrated.estimate)
    for method, made in model.observations[0].closed_forms(values, links, fitted.table).items():
        name = f"hand-eye by {method}"
        if isinstance(made, str):
            errors = [replace(_row(name, "train", np.zeros(0)), failed=made)]
        else:
            errors = image_errors(replace(model, observations=(made,)), model.nominal, data, name)
        rows += [replace(error, method=method) for error in errors]
    return rows


def promised_in_space(calibrated: CalibratedModel, rng: np.random.Generator, name: str) -> list[SpaceError]:
    """Return the tool's predicted error over the joint ranges by the calibrated robot, and that of the nominal one.

    With several links that bear markers, such as two hands, each is represented by its first marker.
    """
    robot, model = calibrated.model.robot, calibrated.model
    links, names = list(robot.marker_links), list(robot.markers)
    payload, first = next(iter(robot.payloads), ""), [links.index(link) for link in dict.fromkeys(links)]
    parts = [candidates(model, RANGE_POSES, payload, names[k], None, rng)[1] for k in first]
    conditions = np.concatenate(parts, axis=1)
    # Projected out for the calibrated robot first: in another robot's directions an arbitrary tool leaves an error.
    taught, taught_nominal = (
        scipy.linalg.block_diag(*(_taught(model.point(p, part), model.rotation(p, part)) for part in parts))
        for p in (calibrated.estimate, model.nominal)
    )
    between = model.point(model.nominal, conditions) - model.point(calibrated.estimate, conditions)
    away = _untaught(between[:, :, None], taught_nominal)
    errors, better = calibrated.errors, 0
    variance = np.full(conditions.shape[1], 3 * errors.rest[METRE] ** 2)
    slopes = errors.slopes(model, calibrated.estimate, conditions)
    choice = choice_errors(calibrated.alternatives, model, calibrated.estimate, points_at(conditions))
    further = [slopes[:, :, len(calibrated.estimate) :] @ errors.spread, choice]
    mean = calibrated.estimate + errors.offset, errors.about_mean(calibrated.covariance)
    probable, *scales = by_scale(*mean, (model.prior_mean, model.prior_sd), strays(model))
    for share, at, covariance, n in zip(probable, *scales, rng.multinomial(ROBOT_DRAWS, probable), strict=True):
        root = errors.root(covariance, at - calibrated.estimate)
        apart = np.concatenate([slopes @ root, *further], axis=2)
        left = _untaught(apart, taught)
        variance += share * (left**2).sum(axis=(1, 2))
        drawn = np.concatenate([np.ones((1, n)), rng.standard_normal((apart.shape[2] - 1, n))])
        of_nominal = away - _untaught(left, taught_nominal) @ drawn
        better += int((((left @ drawn) ** 2).sum(axis=(0, 1)) < (of_nominal**2).sum(axis=(0, 1))).sum())
    off = _row(ALONE, RANGES, np.linalg.norm(away[:, :, 0], axis=1))
    return [off, replace(_row(name, RANGES, np.sqrt(variance)), better=better / ROBOT_DRAWS)]


def _taught(points: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (3 n, 9) of motions of points (n, 3) by base placement and point on the flange."""
    moves = np.concatenate([rigid_slope(points), turned], axis=2)
    return np.asarray(np.linalg.qr(moves.reshape(3 * len(points), 9))[0])


def _untaught(errors: np.ndarray, taught: np.ndarray) -> np.ndarray:
    """Return errors (n, 3, n_sets) without the part that teaching base and tool removes."""
    flat = errors.reshape(len(taught), -1)
    return np.asarray((flat - taught @ (taught.T @ flat)).reshape(errors.shape))


def space_rows(
    calibrated: CalibratedModel, data: Measurements, rng: np.random.Generator, name: str
) -> list[SpaceError]:
    """Return errors in space of hand-eye calibration alone and of a calibrated model; none without images.

    Images of which the fit does not tell whether they are before a step are left out.
    """
    data = data.only(~calibrated.model.undecided(data))
    nominal = Model(calibrated.model.robot, (), data.given, calibrated.model.observations)
    measured = image_errors(nominal, nominal.nominal, data, ALONE)
    if not measured:
        return []
    here = image_errors(calibrated.model, calibrated.estimate, data, name)
    return [*measured, *here, *promised_in_space(calibrated, rng, name)]


def _row(name: str, where: str, far: np.ndarray) -> SpaceError:
    far = 1e3 * far[np.isfinite(far)]
    mean, rms, most = mean_rms_max(far) if len(far) else (np.nan,) * 3
    return SpaceError(model=name, where=where, n=len(far), mean_mm=mean, rms_mm=rms, max_mm=most)


def over_ranges(rows: Sequence[SpaceError]) -> tuple[SpaceError, SpaceError]:
    """Return the errors over the joint ranges of the nominal robot and of the calibrated one."""
    off, promised = (row for row in rows if row.where == RANGES)
    return off, promised


def is_no_better(rows: Sequence[SpaceError]) -> bool:
    """Whether the calibrated tool is not better than the nominal robot's with probability SURELY_BETTER."""
    return over_ranges(rows)[1].better < SURELY_BETTER


def space_words(rows: Sequence[SpaceError]) -> list[str]:
    """Return statements on the tool's error in space in a study by cameras; none for other studies."""
    if not rows:
        return []
    off, promised = over_ranges(rows)
    rows = [row for row in rows if not row.method]
    where = "holdout" if any(row.where == "holdout" for row in rows) else "train"
    seen = {row.model: row for row in rows if row.where == where}
    figures = [f"{name} mean {row.mean_mm:.3f} mm, max {row.max_mm:.3f} mm" for name, row in seen.items() if row.n]
    few = "their points are too few, or on a line, to tell where the target is"
    return [
        f"in space, by the images ({'held out' if where == 'holdout' else 'fitted'}): {', '.join(figures) or few}",
        f"in space, over the joints' ranges, base and tool taught: expected error {promised.mean_mm:.3f} mm on average, "
        f"{promised.max_mm:.3f} mm at worst; the robot as its maker says is {off.mean_mm:.3f} mm off, {off.max_mm:.3f} mm at worst",
    ]
