"""Robust fits of a robot, or of a rigid motion, to positions, with little weight of outliers."""

from __future__ import annotations

import numpy as np

from calflow.model import Model
from calflow.robot.frames import nearest_rotation

PLACED_SD = 0.5  # m and rad: prior of base and tool, practically none
NORMAL_LENGTH = 1.5382  # median length of a vector of three standard normals
WIDTH = 2.5  # robust standard deviations at which a row has half weight
LINEARISED, REWEIGHTED = 12, 8  # linearisations, and reweightings in each
SETTLED = 0.02  # largest motion of a row in the last round, in standard deviations
TINY = 1e-9  # m: below it errors are rounding
OPEN_LOOP_ERROR = 1e3  # m: counted where a loop cannot be closed

# Gross errors, in robust standard deviations of the training rows. Normal noise exceeds 6 in no data set, Student's t with
# 3 degrees of freedom exceeds 15 in one row of a thousand. At 15 a row may be corrected, since a definite mistake must
# also explain it; see outlier.py for unexplained rows. At least half a millimetre: more than unmodelled physics.
GROSS, LEAST_GROSS = 15.0, 5e-4
# Least scale [m], of unmodelled physics: a fit to few rows may leave no residuals.
LEAST_SCALE = LEAST_GROSS / GROSS
FAR_BETTER = 5.0  # factor by which the correction of a mistake must reduce a row's error


def robust_fit(
    model: Model,
    conditions: np.ndarray,
    position: np.ndarray,
    turn: np.ndarray,
    shift: np.ndarray,
    mean: np.ndarray,
    sd: np.ndarray,
    start: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return the robust fit of a model to positions (n_rows, 3): iteratively reweighted least squares, Cauchy weights.

    turn, shift: the approximate base; mean, sd: the prior; start: initial parameters. The noise is the scale of the
    residuals, updated with the weights. A compliance is kept non-negative by an active set.

    Returned are the estimate (n_parameters,), its covariance for errors of the scale, the logarithm of posterior over prior
    volume, and the scale: the robust standard deviation per axis [m] of the rows.
    """
    measured = (position - shift) @ turn
    estimate = start
    least = np.where(model.bounds[:, 0] == model.nominal, mean, -np.inf)
    every = np.flatnonzero(sd)
    free, prior = np.ones(len(every), dtype=bool), np.eye(len(every))
    for _ in range(LINEARISED):
        position, jacobian = model.position_and_jacobian(estimate, conditions)
        left = measured - position
        there = np.isfinite(left).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        jacobian, left = jacobian[there], left[there]
        scaled = (jacobian[:, :, every] * sd[every]).reshape(left.size, len(every))
        aside, scale, error = (mean - estimate)[every] / sd[every], _scale(left, 0.0), left
        step, acting = np.zeros(len(every)), free
        moving = np.ix_(acting, acting)
        for _ in range(REWEIGHTED):
            weight = np.repeat(1 / (1 + (lengths(error) / (WIDTH * scale)) ** 2) / scale**2, 3)
            weighted = scaled * weight[:, None]
            information, gradient = weighted.T @ scaled + prior, weighted.T @ left.ravel() + aside
            uncertain = np.linalg.inv(information[moving])
            step[acting] = uncertain @ gradient[acting]
            moved = (scaled @ step).reshape(left.shape)
            error = left - moved
            scale = _scale(error, (len(uncertain) - uncertain.trace()) / left.size)
        estimate = estimate.copy()
        estimate[every] += step * sd[every]
        pushed = estimate < least
        estimate = np.where(pushed, least, estimate)
        settled = np.abs(moved).max(initial=0.0) < SETTLED * scale
        changed = pushed[every] | (settled & ~acting & (gradient > information @ step))
        if settled and not changed.any():
            break
        free = acting ^ changed
    covariance = np.zeros((len(sd), len(sd)))
    fitted = every[acting]
    covariance[np.ix_(fitted, fitted)] = uncertain * np.outer(sd[fitted], sd[fitted])
    # A compliance held at zero was free in the prior, too: the data determine it as well.
    volume = -float(np.linalg.slogdet(information)[1]) / 2
    return estimate, covariance, volume, scale


def motion(points: np.ndarray, measured: np.ndarray, rounds: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return turn (…, 3, 3), shift (…, 3) and errors (…, n_rows) of the rigid motion from points (…, n_rows, 3) to measured.

    Kabsch (1976) with Cauchy weights; points that are not a number have none.
    """
    there = np.isfinite(points).all(axis=-1)
    points = np.where(there[..., None], points, 0.0)
    weight = there.astype(float)
    for _ in range(rounds):
        total = np.maximum(weight.sum(axis=-1), TINY)[..., None]
        centre = np.einsum("...n,...ni->...i", weight, points) / total
        aim = np.einsum("...n,...ni->...i", weight, np.broadcast_to(measured, points.shape)) / total
        apart, wanted = points - centre[..., None, :], measured - aim[..., None, :]
        turn = nearest_rotation(np.swapaxes(weight[..., None] * wanted, -1, -2) @ apart)
        shift = aim - np.einsum("...ij,...j->...i", turn, centre)
        error = np.where(there, lengths(wanted - np.einsum("...ij,...nj->...ni", turn, apart)), np.inf)
        scale = np.maximum(np.median(error, axis=-1, keepdims=True), TINY)
        with np.errstate(invalid="ignore"):
            weight = np.where(there & np.isfinite(scale), 1 / (1 + (error / scale) ** 2), there * 1.0)
    return turn, shift, error


def rigid_sums(points: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return each row's terms (n_rows, 18) of the sums that determine a rigid motion: 1, p, m, p², m², m pᵀ."""
    there = np.isfinite(points).all(axis=1, keepdims=True)
    p = np.where(there, points, 0.0)
    m = np.where(there, measured, 0.0)
    squares = [(p**2).sum(axis=1), (m**2).sum(axis=1)]
    return np.column_stack([there, p, m, *squares, (m[:, :, None] * p[:, None, :]).reshape(-1, 9)])


def rigid_errors(sums: np.ndarray) -> np.ndarray:
    """Return the mean square error (…) [m²] of the best rigid motion, from sums (…, 18)."""
    n = np.maximum(sums[..., 0], 1.0)
    p, m = sums[..., 1:4] / n[..., None], sums[..., 4:7] / n[..., None]
    correlation = sums[..., 9:].reshape(*sums.shape[:-1], 3, 3) / n[..., None, None] - m[..., :, None] * p[..., None, :]
    gained = (nearest_rotation(correlation) * correlation).sum(axis=(-2, -1))
    spread = (sums[..., 7] + sums[..., 8]) / n - (p**2).sum(axis=-1) - (m**2).sum(axis=-1)
    return np.where(sums[..., 0] > 3, np.maximum(spread - 2 * gained, 0.0), np.inf)


def split_errors(plain: np.ndarray, other: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square errors (n,) [m²] of the best rigid motion if rows up to one, or after it, are replaced.

    plain, other (n_rows, 18): each row's terms of the sums as it is and replaced; rows (n,): the rows tried.
    """
    whole, changed = plain.sum(axis=0), np.cumsum(other - plain, axis=0)
    before, every = changed[rows], changed[-1]
    return rigid_errors(whole + before), rigid_errors(whole + every - before)


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (…) of vectors (…, 3); infinite for nan."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return np.where(np.isnan(length), np.inf, length)


def level(error: np.ndarray) -> np.ndarray:
    """Return the geometric mean of errors (…, n_rows): several outliers count, a single one does not decide."""
    return np.asarray(np.exp(np.log(np.minimum(error, OPEN_LOOP_ERROR) + TINY).mean(axis=-1)))


def _scale(left: np.ndarray, determined: float) -> float:
    """Return the robust standard deviation per axis; determined: the share of degrees of freedom used by the fit."""
    return max(float(np.median(lengths(left))) / NORMAL_LENGTH / np.sqrt(max(1 - determined, 0.1)), LEAST_SCALE)
