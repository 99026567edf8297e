"""Distances between capsules, and of capsules from boxes: of the segments in their middle, all poses at once."""

from __future__ import annotations

import numpy as np

SHORT = 1e-18  # m² (m⁴): a segment's squared length, or that of two segments' cross product, that counts as zero


def between_segments(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances [m] of segments from a to b and from c to d, each (n, 3), shape (n,).

    Nearest points as in Ericson, Real-Time Collision Detection (2005), section 5.1.9; a segment may be a point.
    """
    first, second, apart = b - a, d - c, a - c
    p, q, mixed = _dot(first, first), _dot(second, second), _dot(first, second)
    along, across = _dot(first, apart), _dot(second, apart)
    s = np.clip(_share(mixed * across - along * q, p * q - mixed**2), 0, 1)
    t = np.clip(_share(mixed * s + across, q), 0, 1)
    s = np.clip(_share(mixed * t - along, p), 0, 1)
    return np.linalg.norm(apart + s[:, None] * first - t[:, None] * second, axis=1)


def from_box(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the distances [m] of segments from a to b, each (n, 3), from a box with these corners (3,), shape (n,).

    The squared distance along a segment is convex, and its slope is straight between the places where the segment passes one of
    the box's six planes: where the slope is zero is found exactly.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    start, way = a - middle, b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = np.hstack([(half - start) / way, (-half - start) / way])
    ends = np.tile([0.0, 1.0], (len(a), 1))
    at = np.sort(np.hstack([np.clip(np.nan_to_num(passed), 0, 1), ends]), axis=1)
    points = start[:, None] + at[..., None] * way[:, None]
    slope = _dot(points - np.clip(points, -half, half), way[:, None])
    after = (slope < 0).sum(axis=1).clip(1, at.shape[1] - 1)[:, None]  # the first place where it no longer falls
    (t0, t1), (s0, s1) = ([np.take_along_axis(of, k, axis=1)[:, 0] for k in (after - 1, after)] for of in (at, slope))
    nearest = start + (t0 + (t1 - t0) * np.clip(_share(-s0, s1 - s0), 0, 1))[:, None] * way
    return np.linalg.norm(nearest - np.clip(nearest, -half, half), axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((a * b).sum(axis=-1))


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """A quotient, 0 where the whole is nothing."""
    return np.divide(part, whole, out=np.zeros_like(part), where=np.abs(whole) > SHORT)
