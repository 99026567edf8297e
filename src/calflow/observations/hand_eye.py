"""Closed-form hand-eye calibration: the poses of a camera and a target from images at poses of the nominal robot.

The target's pose in each image follows from a homography (Zhang 2000), with a second solution for a small plane (Schweighofer
and Pinz 2006), or from the direct linear transform if the target is not planar; camera and target from A X = Y D (Shah 2013).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calflow.files.deferred import Rotation
from calflow.robot.frames import crossing, nearest_rotation

FEWEST_IMAGE_POINTS = 4  # points per image
THICKNESS_OF_PLANE = 1e-4  # thickness over extent below which a target is planar
NEWTON_STEPS = 12  # Gauss-Newton iterations
SUBSETS, OF_A_SUBSET = 40, 5  # number and least size of the subsets of images that give a first camera
AGREES = 0.2  # rad: largest rotation error of an inlier image
CHOICE_ROUNDS = 4  # rounds of choosing each image's solution given the camera


Sighting = Sequence[np.ndarray]  # candidate poses of a target in one image, each (4, 4) in the camera's frame


def sighting(points: np.ndarray, rays: np.ndarray) -> Sighting:
    """Return the candidate poses of a target with points (n, 3) [m] seen along rays (x / z, y / z), (n, 2).

    They are in order of reprojection error; none if there are too few points.
    """
    centroid = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - centroid, full_matrices=True)
    if len(points) < FEWEST_IMAGE_POINTS or extent[1] < THICKNESS_OF_PLANE * extent[0]:
        return ()
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    local = (points - centroid) @ axes.T
    flat = len(extent) < 3 or extent[2] < THICKNESS_OF_PLANE * extent[0]
    if not flat and len(points) < 6:
        return ()
    first = _refined(_of_plane(local[:, :2], rays) if flat else _of_body(local, rays), local, rays)
    solutions = [first, _refined(_reflected(first), local, rays)] if flat else [first]
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = axes, -axes @ centroid
    solutions.sort(key=lambda pose: float((_reprojection_error(pose, local, rays) ** 2).sum()))
    return [pose @ back for pose in solutions if np.isfinite(pose).all()]


def focal_length(views: Sequence[tuple[np.ndarray, np.ndarray]], otherwise: float) -> float:
    """Return the focal length [px] by homographies of planar targets (Zhang 2000), assuming square pixels.

    Args:
        views: points of the plane (n, 2) [m], and their images (n, 2) [px] relative to the principal point.
        otherwise: the value returned where the views do not determine it.
    """
    rows, wanted = [], []
    for plane, image in views:
        h = _homography(plane, image / otherwise)
        first, second = h[:, 0], h[:, 1]
        size = np.linalg.norm(h[2]) or 1.0
        rows += [first[:2] @ second[:2], first[:2] @ first[:2] - second[:2] @ second[:2]]
        wanted += [-first[2] * second[2], second[2] ** 2 - first[2] ** 2]
        rows[-2:], wanted[-2:] = [row / size for row in rows[-2:]], [side / size for side in wanted[-2:]]
    squares = float(np.dot(rows, rows))
    inverse = float(np.dot(rows, wanted)) / squares if squares else 0.0
    scale = otherwise / np.sqrt(inverse) if inverse > 0 else otherwise
    return float(scale) if otherwise / 5 < scale < 5 * otherwise else otherwise


def camera_and_target(
    sightings: Sequence[Sighting], hand: np.ndarray, base: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the camera's pose X (4, 4) on its link, the target's Y on its own, and the index of each image's solution.

    hand and base (n, 4, 4) are the frames of the links: hand X pose = base Y in every image. As in RANSAC, subsets of images give
    candidate cameras, and the one with most inliers selects each image's solution (-1: the image is an outlier).
    """
    motion = np.linalg.inv(base) @ hand
    count = max(len(sighting) for sighting in sightings)
    seen = np.array([[*sighting, *[sighting[0]] * (count - len(sighting))] for sighting in sightings])
    n = len(sightings)
    every = np.arange(n)
    best = np.inf
    step = max(1, n // OF_A_SUBSET)
    for k in range(min(SUBSETS, step * count)):
        some = every[(k // count) % step :: step]
        which = np.full(len(some), k % count)
        camera, target = _shah(motion[some], np.linalg.inv(seen[some, which]))
        for _ in range(CHOICE_ROUNDS):
            off = _rotation_errors(motion, seen, camera, target)
            choice = off.argmin(axis=1)
            inliers = np.argsort(off[every, choice])[: max(OF_A_SUBSET, (2 * n) // 3)]
            camera, target = _shah(motion[inliers], np.linalg.inv(seen[inliers, choice[inliers]]))
        cost = float(np.minimum(_rotation_errors(motion, seen, camera, target).min(axis=1), AGREES).sum())
        if cost < best - 1e-12:
            best, placed = cost, (camera, target)
    camera, target = placed
    off = _rotation_errors(motion, seen, camera, target)
    chosen = off.argmin(axis=1)
    return camera, target, np.where(off[every, chosen] < AGREES, chosen, -1)


def _rotation_errors(motion: np.ndarray, seen: np.ndarray, camera: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the rotation error of the target in each image's solutions, (n, n_solutions) [rad]."""
    turned = motion[:, None, :3, :3] @ camera[:3, :3] @ seen[:, :, :3, :3]
    cosine = (np.einsum("ij,nsij->ns", target[:3, :3], turned) - 1) / 2
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _shah(motion: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve motion X = Y seen, (n, 4, 4): rotations by the dominant singular vectors, then translations by least squares."""
    turns, views = motion[:, :3, :3], seen[:, :3, :3]
    kronecker = np.einsum("nij,nkl->ikjl", views, turns).reshape(9, 9)
    left, _, right = np.linalg.svd(kronecker)
    camera, target = np.eye(4), np.eye(4)
    for place, vector in ((camera, right[0]), (target, left[:, 0])):
        matrix = vector.reshape(3, 3).T
        place[:3, :3] = nearest_rotation(matrix * np.sign(np.linalg.det(matrix)))
    n = len(motion)
    system = np.concatenate([turns, np.broadcast_to(-np.eye(3), (n, 3, 3))], axis=2).reshape(-1, 6)
    wanted = (np.einsum("ij,nj->ni", target[:3, :3], seen[:, :3, 3]) - motion[:, :3, 3]).ravel()
    places = np.linalg.lstsq(system, wanted, rcond=1e-6)[0]
    camera[:3, 3], target[:3, 3] = places[:3], places[3:]
    return camera, target


def _homography(plane: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the homography (3, 3) from points of a plane (n, 2) to their images (n, 2), by normalised DLT (Hartley 1997)."""
    (first, to_one), (other, to_other) = _normalised(plane), _normalised(image)
    whole = np.linalg.inv(to_other) @ _projection(first, other) @ to_one
    return np.asarray(whole / np.linalg.norm(whole[:, :2]) * np.sqrt(2))


def _projection(points: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the projection matrix (3, k + 1) from points (n, k) to their images (n, 2), by the direct linear transform."""
    homogeneous = np.column_stack([points, np.ones(len(points))])
    none = np.zeros_like(homogeneous)
    across, down = np.hstack([homogeneous, none]), np.hstack([none, homogeneous])
    lines = np.vstack([np.hstack([side, -image[:, [k]] * homogeneous]) for k, side in enumerate((across, down))])
    return np.asarray(np.linalg.svd(lines, full_matrices=len(lines) < lines.shape[1])[2][-1].reshape(3, -1))


def _normalised(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 2) centred and scaled to unit spread, and the transform (3, 3) that does so."""
    centroid = points.mean(axis=0)
    size = np.sqrt(((points - centroid) ** 2).sum(axis=1).mean()) or 1.0
    return (points - centroid) / size, np.array(
        [[1 / size, 0, -centroid[0] / size], [0, 1 / size, -centroid[1] / size], [0, 0, 1]]
    )


def _of_plane(plane: np.ndarray, rays: np.ndarray) -> np.ndarray:
    h = _homography(plane, rays)
    h = h * (np.sign(h[2, 2]) or 1.0)
    pose = np.eye(4)
    pose[:3, :3] = nearest_rotation(np.column_stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])]))
    pose[:3, 3] = h[:, 2]
    return pose


def _of_body(points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    projection = _projection(points, rays)
    projection = projection / np.cbrt(np.linalg.det(projection[:, :3]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = nearest_rotation(projection[:, :3]), projection[:, 3]
    return pose


def _reflected(pose: np.ndarray) -> np.ndarray:
    """Return the pose with the plane reflected about the line of sight: the second solution of a small plane."""
    sight = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    half = 2 * np.outer(sight, sight) - np.eye(3)
    other = pose.copy()
    other[:3, :3] = half @ pose[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return other


def _reprojection_error(pose: np.ndarray, points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    there = points @ pose[:3, :3].T + pose[:3, 3]
    return np.asarray(there[:, :2] / there[:, 2:] - rays)


def _refined(pose: np.ndarray, points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return the pose refined by Levenberg-Marquardt on the reprojection error."""
    damping, cost = 1e-3, float((_reprojection_error(pose, points, rays) ** 2).sum())
    for _ in range(NEWTON_STEPS):
        turned = points @ pose[:3, :3].T
        x, y, z = (turned + pose[:3, 3]).T
        by_place = np.zeros((len(points), 2, 3))
        by_place[:, 0, 0] = by_place[:, 1, 1] = 1 / z
        by_place[:, 0, 2], by_place[:, 1, 2] = -x / z**2, -y / z**2
        slope = np.concatenate([by_place @ crossing(-turned), by_place], axis=2).reshape(-1, 6)
        normal, gradient = slope.T @ slope, slope.T @ _reprojection_error(pose, points, rays).ravel()
        step = -np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), gradient, rcond=None)[0]
        moved = pose.copy()
        moved[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ pose[:3, :3]
        moved[:3, 3] += step[3:]
        new = float((_reprojection_error(moved, points, rays) ** 2).sum())
        if new < cost and (moved[2, 3] > 0):
            pose, damping, cost, gained = moved, damping / 10, new, cost - new
            if gained < 1e-10 * cost:
                break
        else:
            damping *= 10
    return pose
