"""Stated lens: stated intrinsic parameters of a camera that its images contradict.

With the pose of the target free in each image, and its shape stretched or bowed, the remaining errors are the lens's
(Zhang, IEEE Trans. PAMI 22, 2000). No robot error imitates them, so this is settled before the robot is fitted: a wrong
lens is then estimated as if it were not stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calflow.effects.board_bent import REACH
from calflow.faults.base import SET_UP, Correction, Fault, fault
from calflow.files.deferred import pd
from calflow.measurements.measurements import Measurements, image_numbers
from calflow.observations import observations
from calflow.observations.camera import IMAGES, LENS_SETTINGS, Camera, spaced
from calflow.observations.hand_eye import sighting
from calflow.observations.hand_eye_methods import crossing
from calflow.observations.lens import slopes

FALSE_ALARM = 1e-3  # probability of rejecting a lens that is as stated
OUTLIER_LIMIT = 5.0  # robust standard deviations beyond which points are rejected
ROUNDS = 3  # rounds of rejection
RANK_TOLERANCE = 1e-8  # relative singular value below which a direction is unidentifiable
POSE, SHAPE = 6, 6  # parameters of a target's pose, and of its stretch along x and y, skew and bow (see `OnTarget`)


def stated_lens(data: Measurements) -> tuple[Fault, ...]:
    """Return one fault per series whose stated lens the images contradict; it is then estimated."""
    if not any(series.kind == Camera.id and series.setting("focal") for series in data.series):
        return ()
    train, faults = data.only(data.train), []
    for k, camera in enumerate(observations(train)):
        if not isinstance(camera, Camera) or not camera.series.setting("focal"):
            continue
        rows, eyes = train.table[train.of_series(k)], range(len(camera.cameras))
        lenses = [lens for eye in eyes if (lens := lens_by_images(camera, eye, rows))]
        if lenses and (least := min(lenses, key=lambda lens: lens.chance)).chance * len(lenses) < FALSE_ALARM:
            row = 1 + int(np.flatnonzero(data.of_series(k))[0]) if len(data.series) > 1 else 0
            stated = [name for name in LENS_SETTINGS if camera.series.setting(name) is not None]
            corrections = [Correction(row, name, 0.0) for name in stated]
            statement = least.words(camera, len(data.series) > 1)
            faults.append(fault("stated-lens", data, 0, corrections, "corrected", statement, SET_UP))
    return tuple(faults)


@dataclass(frozen=True, eq=False)
class LensComparison:
    """A camera's stated lens compared with its images.

    deviation (n,): estimated minus stated parameters; chance: p-value of the stated lens; stated_px, free_px: root mean
    square errors of the points with the stated and with the estimated lens, poses of the target free.
    """

    camera: int
    deviation: np.ndarray
    chance: float
    stated_px: float
    free_px: float

    def words(self, camera: Camera, several: bool) -> str:
        """Return the comparison in words; several: whether there are other series."""
        stated, name = camera.lens(self.camera).focal[0], camera.cameras[self.camera].name
        whose = (f" of camera {name}" if name else "") + (f" of measurements {camera.part}" if several else "")
        return (
            f"the stated lens{whose} does not fit the images: for any pose of the target the points are off by "
            f"{self.stated_px:.3g} px (rms), and by {self.free_px:.3g} px with a focal length of about "
            f"{stated + self.deviation[0]:.0f} px instead of {stated:.0f} px; the lens is estimated; state the right one or none"
        )


def lens_by_images(camera: Camera, eye: int, rows: pd.DataFrame) -> LensComparison | None:
    """Return the comparison of a camera's stated lens with its images (at most IMAGES); None if they do not determine it.

    The null hypothesis has errors of the stated standard deviations, the alternative those of an unknown lens.
    """
    own = rows[camera.reported(rows)[5 + eye] > 0]
    images = image_numbers(own)
    views = [_image_columns(camera, eye, own[images == image]) for image in spaced(np.unique(images), IMAGES)]
    seen = [view for view in views if view is not None]
    if not seen:
        return None
    every = np.concatenate(seen)
    number = np.repeat(np.arange(len(seen)), [len(view) for view in seen])
    near, n_shapes = np.ones(len(every), dtype=bool), SHAPE * len(camera.targets)
    for _ in range(ROUNDS):
        left = np.concatenate(
            [_residual_columns(every[number == k], POSE, near[number == k]) for k in range(len(seen))]
        )
        left = _residual_columns(left, n_shapes, near)
        slope, error = left[:, :-1], left[:, -1]
        step, _, rank, _ = np.linalg.lstsq(slope[near], -error[near], rcond=RANK_TOLERANCE)
        free = error + slope @ step
        near = np.abs(free) < OUTLIER_LIMIT * np.median(np.abs(free)) / scipy.stats.norm.ppf(0.75)
    freedom = int(near.sum()) - POSE * len(seen) - n_shapes - int(rank)
    if freedom < 1:
        return None
    variance = float((free[near] ** 2).sum() / freedom)
    sd, unknown_sd = camera.lens_sd(eye), camera.lens_sd(eye, unknown=True)
    prior = (sd / unknown_sd) ** 2
    slope, error = slope[near], error[near]
    information, gradient = slope.T @ slope / variance, slope.T @ error / variance
    spread = information + information * prior @ information
    statistic = float(gradient @ np.linalg.pinv(spread, RANK_TOLERANCE, hermitian=True) @ gradient) / int(rank)
    return LensComparison(
        eye,
        -unknown_sd * np.linalg.solve(information + np.eye(len(prior)), gradient),
        float(scipy.stats.f.sf(statistic, rank, freedom)),
        float(np.sqrt(2 * (error**2).sum() / (freedom + rank))),
        float(np.sqrt(2 * variance)),
    )


def _residual_columns(columns: np.ndarray, first: int, near: np.ndarray) -> np.ndarray:
    """Return the further columns of (n, m) with the first ones projected out, by the rows near (n,)."""
    explained = np.linalg.lstsq(columns[near, :first], columns[near, first:], rcond=RANK_TOLERANCE)[0]
    return np.asarray(columns[:, first:] - columns[:, :first] @ explained)


def _image_columns(camera: Camera, eye: int, rows: pd.DataFrame) -> np.ndarray | None:
    """Return the Jacobian of an image's points by target pose, target shapes and lens (scaled by its prior), then the errors.

    Shape (2 n_points, n_columns) [px]; None if the points do not determine the target's pose.
    """
    lens, which = camera.lens(eye), camera.reported(rows)
    image, points, target = which[:2].T, which[2:5].T, which[5 + len(camera.cameras) :, 0]
    if not (poses := sighting(points, lens.rays(image))):
        return None
    turn, place = poses[0][:3, :3], poses[0][:3, 3]
    there = points @ turn.T + place
    by_point, by_lens = slopes(lens.model, there, np.tile(lens.figures, (len(there), 1)))
    (x, y, _), shape = points.T / REACH, np.zeros((len(points), 3, SHAPE))
    shape[:, 0, 0], shape[:, 1, 1] = x, y
    shape[:, 0, 2], shape[:, 1, 2] = y, x
    shape[:, 2, 3], shape[:, 2, 4], shape[:, 2, 5] = x * x, x * y, y * y
    columns = [
        by_point,
        by_point @ crossing(there),
        np.kron(target, by_point @ turn @ shape),
        by_lens * camera.lens_sd(eye, unknown=True),
    ]
    return np.concatenate([*columns, (lens.image(there) - image)[:, :, None]], axis=2).reshape(2 * len(points), -1)
