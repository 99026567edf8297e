"""Stated lens: figures of a camera that its images contradict, whatever moves camera and target.

Each image may show its target anywhere: what no place of it explains, nor a target that is stretched or bowed, is the lens's
(Zhang, IEEE Trans. PAMI 22, 2000). No robot imitates that, so that it is settled before anything is fitted to the robot: from
there on the lens is found with the rest, as if it were not stated.
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

FALSE = 1e-3  # chance that a lens that is as stated is called another
OUTLIER_LIMIT = 5.0  # robust standard deviations: points further off tell nothing of a lens
ROUNDS = 3  # rounds that find these points
RANK_TOLERANCE = 1e-8  # of the largest singular value: images do not tell what they tell less of
PLACE, SHAPE = 6, 6  # figures of a target's place, and of its stretch along x and y, skew and bow (see `OnTarget`)


def stated_lens(data: Measurements) -> tuple[Fault, ...]:
    """Find a lens that is stated and is not that of the images, which is found with the rest then: a fault a series."""
    if not any(series.kind == Camera.id and series.setting("focal") for series in data.series):
        return ()
    train, faults = data.only(data.train), []
    for k, camera in enumerate(observations(train)):
        if not isinstance(camera, Camera) or not camera.series.setting("focal"):
            continue
        rows, eyes = train.table[train.of_series(k)], range(len(camera.cameras))
        lenses = [lens for eye in eyes if (lens := lens_by_images(camera, eye, rows))]
        if lenses and (least := min(lenses, key=lambda lens: lens.chance)).chance * len(lenses) < FALSE:
            row = 1 + int(np.flatnonzero(data.of_series(k))[0]) if len(data.series) > 1 else 0
            stated = [name for name in LENS_SETTINGS if camera.series.setting(name) is not None]
            corrections = [Correction(row, name, 0.0) for name in stated]
            statement = least.words(camera, len(data.series) > 1)
            faults.append(fault("stated-lens", data, 0, corrections, "corrected", statement, SET_UP))
    return tuple(faults)


@dataclass(frozen=True, eq=False)
class LensByImages:
    """What a camera's images say of its lens by themselves.

    deviation (n,) are its figures less those stated, chance that noise alone makes images contradict these as much, and stated_px
    and free_px the root mean squares of what points are off with each, whatever the places of target and camera.
    """

    camera: int
    deviation: np.ndarray
    chance: float
    stated_px: float
    free_px: float

    def words(self, camera: Camera, several: bool) -> str:
        """Say what is wrong; several says whether other series are there."""
        stated, name = camera.lens(self.camera).focal[0], camera.cameras[self.camera].name
        whose = (f" of camera {name}" if name else "") + (f" of measurements {camera.part}" if several else "")
        return (
            f"the stated lens{whose} is not that of the images: wherever camera and target were, points are "
            f"{self.stated_px:.3g} px (rms) from where it shows them, {self.free_px:.3g} px with another, whose focal length is "
            f"about {stated + self.deviation[0]:.0f} px for {stated:.0f} px; it is found with the rest, state the right one or none"
        )


def lens_by_images(camera: Camera, eye: int, rows: pd.DataFrame) -> LensByImages | None:
    """Return what a camera's images (at most IMAGES of its rows') say of its lens by themselves; None where that is nothing.

    A lens that is as stated has errors of the standard deviations stated, one that nobody knows of its own.
    """
    own = rows[camera.reported(rows)[5 + eye] > 0]
    images = image_numbers(own)
    views = [_of_image(camera, eye, own[images == image]) for image in spaced(np.unique(images), IMAGES)]
    seen = [view for view in views if view is not None]
    if not seen:
        return None
    every = np.concatenate(seen)
    number = np.repeat(np.arange(len(seen)), [len(view) for view in seen])
    near, n_shapes = np.ones(len(every), dtype=bool), SHAPE * len(camera.targets)
    for _ in range(ROUNDS):
        left = np.concatenate([_beside(every[number == k], PLACE, near[number == k]) for k in range(len(seen))])
        left = _beside(left, n_shapes, near)
        slope, error = left[:, :-1], left[:, -1]
        step, _, rank, _ = np.linalg.lstsq(slope[near], -error[near], rcond=RANK_TOLERANCE)
        free = error + slope @ step
        near = np.abs(free) < OUTLIER_LIMIT * np.median(np.abs(free)) / scipy.stats.norm.ppf(0.75)
    freedom = int(near.sum()) - PLACE * len(seen) - n_shapes - int(rank)
    if freedom < 1:
        return None
    variance = float((free[near] ** 2).sum() / freedom)
    sd, unknown_sd = camera.lens_sd(eye), camera.lens_sd(eye, unknown=True)
    prior = (sd / unknown_sd) ** 2
    slope, error = slope[near], error[near]
    told, gradient = slope.T @ slope / variance, slope.T @ error / variance
    spread = told + told * prior @ told
    statistic = float(gradient @ np.linalg.pinv(spread, RANK_TOLERANCE, hermitian=True) @ gradient) / int(rank)
    return LensByImages(
        eye,
        -unknown_sd * np.linalg.solve(told + np.eye(len(prior)), gradient),
        float(scipy.stats.f.sf(statistic, rank, freedom)),
        float(np.sqrt(2 * (error**2).sum() / (freedom + rank))),
        float(np.sqrt(2 * variance)),
    )


def _beside(columns: np.ndarray, first: int, near: np.ndarray) -> np.ndarray:
    """The further columns of (n, m) without what the first ones explain of the rows near (n,)."""
    explained = np.linalg.lstsq(columns[near, :first], columns[near, first:], rcond=RANK_TOLERANCE)[0]
    return np.asarray(columns[:, first:] - columns[:, :first] @ explained)


def _of_image(camera: Camera, eye: int, rows: pd.DataFrame) -> np.ndarray | None:
    """What the points of an image move by: its target's place, its targets' shapes, the lens (over what is not known of it).

    The last column is what they are off; (2 n_points, n_columns) [px]. None where they do not tell the target's place.
    """
    lens, which = camera.lens(eye), camera.reported(rows)
    image, points, target = which[:2].T, which[2:5].T, which[5 + len(camera.cameras) :, 0]
    if (sighted := sighting(points, lens.rays(image))) is None:
        return None
    turn, place = sighted.poses[0][:3, :3], sighted.poses[0][:3, 3]
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
