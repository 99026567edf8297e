"""Alignment: the frame in which a device stood when it stood elsewhere, by the rigid motion that fits its points best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

FREEDOM = 6  # numbers that a frame takes away
FEWEST = 4  # poses, of fewer a frame leaves nothing to judge
IN_LINE = 1e-3  # of their spread, by which points must leave a line to show a turn


@dataclass(frozen=True)
class Alignment:
    """A rigid motion of measured points: turned (3, 3) and shifted (3,) [m] into the frame of the expected ones."""

    turn: np.ndarray
    shift: np.ndarray

    @staticmethod
    def best(measured: np.ndarray, expected: np.ndarray, weight: np.ndarray) -> Alignment:
        """Return the motion that takes measured to expected points (n, 3) [m] with least weighted squares (Kabsch 1976)."""
        share = weight / weight.sum()
        centre, aim = share @ measured, share @ expected
        turn, _ = Rotation.align_vectors(expected - aim, measured - centre, weights=share)
        return Alignment(turn.as_matrix(), aim - turn.apply(centre))

    @staticmethod
    def none() -> Alignment:
        """Return the motion that leaves everything where it is."""
        return Alignment(np.eye(3), np.zeros(3))

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points (n, 3) [m] moved."""
        return np.asarray(points @ self.turn.T + self.shift)

    def moved(self, points: np.ndarray) -> float:
        """Return how far the motion takes points (n, 3) [m], on average [m]."""
        return float(np.linalg.norm(self.of(points) - points, axis=1).mean())

    @property
    def angle(self) -> float:
        """By how much it turns [rad]."""
        return float(Rotation.from_matrix(self.turn).magnitude())


def can_align(points: np.ndarray) -> bool:
    """Whether points (n, 3) are many enough, and not on one line, so that a frame can be fitted and something be left."""
    if len(points) < FEWEST:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > IN_LINE * spread[0])


def rigid_slope(points: np.ndarray) -> np.ndarray:
    """Return what a shift, and a turn about their middle, do to points (n, 3), shape (n, 3, 6) [m per m and rad]."""
    arm = points - points.mean(axis=0)
    cross = np.zeros((len(arm), 3, 3))
    cross[:, [1, 2, 0], [2, 0, 1]], cross[:, [2, 0, 1], [1, 2, 0]] = arm, -arm
    return np.concatenate([np.tile(np.eye(3), (len(arm), 1, 1)), cross], axis=2)


def restored(errors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return errors (n, 3) that a fitted frame has made smaller, as large as errors independent of each other were before.

    Each is divided by the root of one minus its leverage in the fit (MacKinnon and White 1985, HC2); points (n, 3) say where.
    """
    slope = rigid_slope(points)
    whole = np.linalg.inv(np.einsum("nai,naj->ij", slope, slope))
    left = np.eye(3) - slope @ whole @ slope.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(left)
    root = np.maximum(values, 1e-12) ** -0.5
    return np.asarray(np.einsum("nai,ni,nbi,nb->na", vectors, root, vectors, errors))


def errors_left_out(measured: np.ndarray, expected: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return measured minus expected points (n, 3) [m], those of each pose (n,) in the frame that fits all other poses best.

    So a further pose is seen: it errs by what the frame is off there besides, of which the frame's own poses show the less the
    fewer they are. nan where the other poses are too few, or lie on one line.
    """
    found = np.full_like(measured, np.nan)
    for name in np.unique(pose):
        own = pose == name
        if can_align(measured[~own]):
            frame = Alignment.best(measured[~own], expected[~own], np.ones((~own).sum()))
            found[own] = frame.of(measured[own]) - expected[own]
    return found
