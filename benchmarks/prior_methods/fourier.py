"""A Fourier series of each joint's angle error, fitted by linear least squares to what geometry leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calflow.effects.periodic_joint_error import PeriodicJointError
from calflow.measurements.measurements import Measurements
from prior_methods.method import Predictor, timed
from prior_methods.physical import Calibrated, calibrated

ORDERS = (1, 2, 4, 8, 16)  # highest of each series
RIDGES = (1e-9, 1e-6, 1e-3, 1e-1)  # over the mean square of a column
FOLDS = 5


@dataclass(frozen=True)
class Fourier:
    """dq_i = sum over k of a_ik cos(k q_i) + b_ik sin(k q_i); how far it goes is chosen by cross-validation over poses."""

    name: str = "geometry + Fourier series per joint"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit geometry, then the series to what it leaves."""
        geometry = calibrated(train, "geometry")
        left = (train.position - geometry.positions(train)).ravel()
        poses, lever = np.repeat(train.table["pose"].to_numpy(), 3), levers(geometry, train)
        columns = {order: regressors(lever, train.joints, order) for order in ORDERS}
        order, ridge = min(
            product(ORDERS, RIDGES), key=lambda tried: crossed(columns[tried[0]], left, poses, ridge=tried[1])
        )
        amplitudes = solved(columns[order], left, ridge)

        def positions(rows: Measurements) -> np.ndarray:
            moved = regressors(levers(geometry, rows), rows.joints, order) @ amplitudes
            return geometry.positions(rows) + moved.reshape(-1, 3)

        return positions


def levers(known: Calibrated, rows: Measurements) -> np.ndarray:
    """Return how each joint's angle moves the tool, shape (n_rows, 3, n_joints) [m/rad]: derivatives of the model's graph."""
    whole_turn = PeriodicJointError(
        known.model.robot, order=0.0
    )  # its cosine is 1: an error that is the same everywhere
    model = replace(known.model, probes=(whole_turn,))
    at = np.append(known.estimate, np.zeros(len(whole_turn.declared)))
    cosines = model.columns(whole_turn)[::2]
    return model.position_jacobian(at, rows.on(model.robot).conditions)[:, :, cosines]


def regressors(lever: np.ndarray, joints: np.ndarray, order: int) -> np.ndarray:
    """Return what each term's amplitude does to the stacked positions, shape (3 n_rows, 2 order n_joints)."""
    angle = joints[:, :, None] * np.arange(1, order + 1)
    terms = np.concatenate([np.cos(angle), np.sin(angle)], axis=2)
    return (lever[:, :, :, None] * terms[:, None]).reshape(3 * len(joints), -1)


def solved(columns: np.ndarray, left: np.ndarray, ridge: float) -> np.ndarray:
    """Return the amplitudes of linear least squares, shape (n_columns,)."""
    normal = columns.T @ columns
    size = np.trace(normal) / len(normal)
    return np.linalg.solve(normal + ridge * size * np.eye(len(normal)), columns.T @ left)


def crossed(columns: np.ndarray, left: np.ndarray, poses: np.ndarray, ridge: float) -> float:
    """Return the sum of squares [m²] of what fits without a fold's poses leave of them."""
    fold = np.unique(poses, return_inverse=True)[1] % FOLDS
    total = 0.0
    for k in range(FOLDS):
        amplitudes = solved(columns[fold != k], left[fold != k], ridge)
        total += float(((left[fold == k] - columns[fold == k] @ amplitudes) ** 2).sum())
    return total
