"""Elsewhere: what a model errs by at poses that it was not fitted to, by leaving out each training pose in turn.

Where a model lacks something, its parameters make up for it at the poses that they were fitted to, and most at those that hang on
few others. What is left there tells too little of other poses; errors of poses that were left out tell it (Stone 1974). They
come from one Jacobian, without a refit (Allen's PRESS 1974): with H a pose's share in its own prediction they are
(I - H)⁻¹ times the residual, and (I - H)⁻¹ is their covariance, over the noise, where the model lacks nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calflow.estimation.fit import Fit


def elsewhere(fit: Fit, pose: np.ndarray) -> float:
    """Return by how much more a fitted model errs at poses left out than noise and parameters say, sd per axis [m]; at least 0.

    Args:
        fit: the model as it was fitted; orientations are left out of account.
        pose: the number of each row's pose, (n_rows,): rows of one pose are left out together.
    """
    found, expected, shares = 0.0, 0.0, list[float]()
    for residual, jacobian in _by_pose(fit, pose):
        covered = np.linalg.inv(np.eye(len(residual)) - jacobian @ fit.covariance @ jacobian.T)
        missed = covered @ residual
        found, expected = found + missed @ missed, expected + np.trace(covered)
        shares.append(np.trace(covered) / len(residual))
    if not shares:
        return 0.0
    more = max(found / expected - 1.0, 0.0) * float(np.median(shares))
    return float(np.sqrt(more)) * fit.problem.scatter


def left_out(fit: Fit, pose: np.ndarray) -> float:
    """Return the root mean square error of poses that are left out in turn, all axes together, noise in it [m]; nan without any.

    Args: as of `elsewhere`.
    """
    missed = [
        np.linalg.inv(np.eye(len(residual)) - jacobian @ fit.covariance @ jacobian.T) @ residual
        for residual, jacobian in _by_pose(fit, pose)
    ]
    squared = np.concatenate(missed or [np.full(1, np.nan)]) ** 2
    return float(np.sqrt(3 * squared.mean())) * fit.problem.scatter


def _by_pose(fit: Fit, pose: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield each pose's whitened residuals (n,), of lengths, and their Jacobian (n, n_parameters)."""
    for block in fit.problem.reweighted(fit.estimate, fit.loss).blocks:
        lengths = np.array([unit != "rad" for unit in block.observation.units])
        for rows, *part in block.linearised(fit.estimate):
            residual, jacobian = block.independent(*part)
            order = np.argsort(pose[rows], kind="stable")
            ends = np.flatnonzero(np.diff(pose[rows][order])) + 1
            for own in np.split(order, ends):
                yield residual[own][:, lengths].ravel(), jacobian[own][:, lengths].reshape(-1, jacobian.shape[2])
