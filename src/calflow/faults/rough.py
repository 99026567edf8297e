"""A rough fit: a robot, or a rigid motion, that explains positions so that wrong rows hardly count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.measurements.measurements import Measurements
from calflow.model import Model

PLACED_SD = 0.5  # m and rad: where base and tool are is left to the data
NORMAL_LENGTH = 1.5382  # median length of a vector of three unit normals
WIDTH = 2.5  # robust standard deviations at which a row counts half
LINEARISED, REWEIGHTED = 12, 8  # rounds of the fit, and in each of the weights
BLOCK = 60  # equations that are multiplied at once
SETTLED = 0.02  # standard deviations by which the last round moves a row
TINY = 1e-9  # m: below it errors are rounding
OPEN_LOOP_ERROR = 1e3  # m: where a loop cannot be closed

# Errors are told apart by robust standard deviations of the training rows (1.48 median deviations, for three axes). Normal
# noise passes 6 in no data set, Student's t with 3 degrees of freedom passes 15 in one row of a thousand. A row may be
# mended at 15, since then a definite mistake must also bring it back among the others; see outlier.py for rows that
# nothing explains. What is gross is more than a robot's physics does to single rows, so at least half a millimetre.
GROSS, LEAST_GROSS = 15.0, 5e-4
# What a robot's physics leaves of any fit [m]; where rows are few, a fit may leave nothing.
LEAST_SCALE = LEAST_GROSS / GROSS
FAR_BETTER = 5.0  # times by which a mistake, once put right, must lessen a row's error


@dataclass(frozen=True)
class Expectation:
    """Where a robot's parameters are expected before it is measured: mean and standard deviation, each (n_parameters,), in SI.

    A parameter whose standard deviation is zero stays at its mean.
    """

    mean: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True)
class Rough:
    """A robust fit: scale is the robust standard deviation per axis [m] of the rows it was fitted to.

    covariance (n_parameters, n_parameters) is that of the estimate for errors of that scale, and volume the logarithm of the
    share of what is expected that the data leave; turn (3, 3) and shift (3,) take points from the robot's base to the measuring
    frame.
    """

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    volume: float
    scale: float
    turn: np.ndarray
    shift: np.ndarray
    expected: Expectation

    @property
    def gross(self) -> float:
        """The error [m] from which a row is gross."""
        return GROSS * self.scale

    @property
    def deviations(self) -> np.ndarray:
        """How far each parameter is from where it is expected, in standard deviations, shape (n_parameters,)."""
        sd = self.expected.sd  # 0 of what cannot deviate
        return np.divide(self.estimate - self.expected.mean, sd, out=np.zeros(len(sd)), where=sd > 0)

    @property
    def deviation(self) -> float:
        """How far the robot is from its nominal: its parameters' squares in standard deviations."""
        return float((self.deviations**2).sum())

    def predicted(self, conditions: np.ndarray) -> np.ndarray:
        """Return positions (n_rows, 3) [m] for packed conditions; nan where a loop cannot be closed."""
        return self.model.position(self.estimate, conditions) @ self.turn.T + self.shift

    def moved(self, conditions: np.ndarray, joint: int, by: float) -> np.ndarray:
        """Return how far a step of a joint (from 0) [rad or m] moves positions (n_rows, 3) [m]."""
        stepped = conditions.copy()
        stepped[joint] += by
        return self.predicted(stepped) - self.predicted(conditions)

    def miss(self, data: Measurements) -> np.ndarray:
        """Return how far each row's position is from where the others say it should be, shape (n_rows,) [m].

        A gross row counts less where the fit itself is unsure, as it is far from the rows that were fitted.
        """
        miss = lengths(data.position - self.predicted(data.conditions))
        far = np.isfinite(miss) & (miss > self.gross)
        if far.any():
            jacobian = self.model.position_jacobian(self.estimate, data.conditions[:, far])
            variance = ((jacobian @ self.covariance) * jacobian).sum(axis=2).max(axis=1)
            miss[far] /= np.sqrt(1 + variance / self.scale**2)
        return miss

    def better(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Whether errors (…) [m] fall from gross to what the other rows have."""
        return (before > self.gross) & (after < np.minimum(self.gross, before / FAR_BETTER))


def rough(
    model: Model,
    conditions: np.ndarray,
    position: np.ndarray,
    turn: np.ndarray,
    shift: np.ndarray,
    expected: Expectation,
    start: np.ndarray,
) -> Rough:
    """Fit a model to positions (n_rows, 3) by least squares in which wrong rows weigh little (Cauchy).

    The robot's base is near where turn and shift say. The noise is the scale of the errors themselves, taken anew with the
    weights; the model is linearised until it settles, from start. A spring that would push is held at none, until it would pull.
    """
    measured = (position - shift) @ turn
    mean, prior, estimate = expected.mean, expected.sd, start
    least = np.where(model.bounds[:, 0] == model.nominal, mean, -np.inf)
    every = np.flatnonzero(prior)
    free = np.ones(len(every), dtype=bool)
    for _ in range(LINEARISED):
        position, jacobian = model.position_and_jacobian(estimate, conditions)
        left = measured - position
        there = np.isfinite(left).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        jacobian, left = jacobian[there], left[there]
        scaled = _blocks((jacobian[:, :, every] * prior[every]).reshape(left.size, len(every)))
        aside, scale, error = (mean - estimate)[every] / prior[every], _scale(left, 0.0), left
        step, acting = np.zeros(len(every)), free
        moving = np.ix_(acting, acting)
        for _ in range(REWEIGHTED):
            weight = np.repeat(1 / (1 + (lengths(error) / (WIDTH * scale)) ** 2) / scale**2, 3)
            weighted = scaled * _blocks(weight[:, None])
            data_only = (weighted.transpose(0, 2, 1) @ scaled).sum(axis=0)
            gradient = (weighted.transpose(0, 2, 1) @ _blocks(left.reshape(-1, 1))).sum(axis=0)[:, 0] + aside
            information = data_only + np.eye(len(every))
            step[acting] = np.linalg.solve(information[moving], gradient[acting])
            moved = (scaled @ step).ravel()[: left.size].reshape(left.shape)
            error = left - moved
            scale = _scale(error, np.trace(np.linalg.solve(information[moving], data_only[moving])) / left.size)
        estimate = estimate.copy()
        estimate[every] += step * prior[every]
        pushed = estimate < least
        estimate = np.where(pushed, least, estimate)
        settled = np.abs(moved).max(initial=0.0) < SETTLED * scale
        changed = pushed[every] | (settled & ~acting & (gradient > information @ step))
        if settled and not changed.any():
            break
        free = acting ^ changed
    covariance = np.zeros((len(prior), len(prior)))
    fitted = every[acting]
    covariance[np.ix_(fitted, fitted)] = np.linalg.inv(information[moving]) * np.outer(prior[fitted], prior[fitted])
    # A spring that is held was as free before the data as one that pulls: they tell as much of it.
    volume = -float(np.linalg.slogdet(information)[1]) / 2
    return Rough(model, estimate, covariance, volume, scale, turn, shift, expected)


def motion(points: np.ndarray, measured: np.ndarray, rounds: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return turn (…, 3, 3), shift (…, 3) and errors (…, n_rows) of the rigid motion from points (…, n_rows, 3) to measured.

    Kabsch's (1976), with weights that make far rows count little; points that are not a number do not count.
    """
    there = np.isfinite(points).all(axis=-1)
    points = np.where(there[..., None], points, 0.0)
    weight = there.astype(float)
    for _ in range(rounds):
        total = np.maximum(weight.sum(axis=-1), TINY)[..., None]
        centre = np.einsum("...n,...ni->...i", weight, points) / total
        aim = np.einsum("...n,...ni->...i", weight, np.broadcast_to(measured, points.shape)) / total
        apart, wanted = points - centre[..., None, :], measured - aim[..., None, :]
        turn = best_turn(np.swapaxes(weight[..., None] * wanted, -1, -2) @ apart)
        shift = aim - np.einsum("...ij,...j->...i", turn, centre)
        error = np.where(there, lengths(wanted - np.einsum("...ij,...nj->...ni", turn, apart)), np.inf)
        scale = np.maximum(np.median(error, axis=-1, keepdims=True), TINY)
        with np.errstate(invalid="ignore"):
            weight = np.where(there & np.isfinite(scale), 1 / (1 + (error / scale) ** 2), there * 1.0)
    return turn, shift, error


def best_turn(correlation: np.ndarray) -> np.ndarray:
    """Return the rotations (…, 3, 3) that make the trace of turnᵀ correlation largest."""
    u, _, v = np.linalg.svd(correlation)
    u = u.copy()
    u[..., :, 2] *= np.sign(np.linalg.det(u @ v))[..., None]
    return u @ v


def rigid_sums(points: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return each row's part (n_rows, 17) of the sums that a rigid motion follows from: 1, p, m, p², m², m pᵀ."""
    there = np.isfinite(points).all(axis=1, keepdims=True)
    p = np.where(there, points, 0.0)
    m = np.where(there, measured, 0.0)
    squares = [(p**2).sum(axis=1), (m**2).sum(axis=1)]
    return np.column_stack([there, p, m, *squares, (m[:, :, None] * p[:, None, :]).reshape(-1, 9)])


def rigid_errors(sums: np.ndarray) -> np.ndarray:
    """Return the mean square error (…) [m²] that the best rigid motion leaves, from sums (…, 18)."""
    n = np.maximum(sums[..., 0], 1.0)
    p, m = sums[..., 1:4] / n[..., None], sums[..., 4:7] / n[..., None]
    correlation = sums[..., 9:].reshape(*sums.shape[:-1], 3, 3) / n[..., None, None] - m[..., :, None] * p[..., None, :]
    gained = (best_turn(correlation) * correlation).sum(axis=(-2, -1))
    spread = (sums[..., 7] + sums[..., 8]) / n - (p**2).sum(axis=-1) - (m**2).sum(axis=-1)
    return np.where(sums[..., 0] > 3, np.maximum(spread - 2 * gained, 0.0), np.inf)


def otherwise(plain: np.ndarray, other: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square errors (n,) [m²] of the best rigid motion if all up to a row, or all after it, are otherwise.

    plain and other (n_rows, 18) are each row's part of the sums as it is and otherwise; rows (n,) are those that are tried.
    """
    whole, changed = plain.sum(axis=0), np.cumsum(other - plain, axis=0)
    before, every = changed[rows], changed[-1]
    return rigid_errors(whole + before), rigid_errors(whole + every - before)


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (…) of vectors (…, 3); infinite where one is not a number."""
    return np.nan_to_num(np.sqrt((vectors**2).sum(axis=-1)), nan=np.inf)


def level(error: np.ndarray) -> np.ndarray:
    """Return the geometric mean of errors (…, n_rows): a few rows that are off show, and one alone does not decide."""
    return np.asarray(np.exp(np.log(np.minimum(error, OPEN_LOOP_ERROR) + TINY).mean(axis=-1)))


def _blocks(rows: np.ndarray) -> np.ndarray:
    """Return rows (n_rows, n) in blocks (n_blocks, BLOCK, n), filled up with zeros.

    Products of blocks are too small to be shared among threads, which costs more than it gains where others compute too.
    """
    filled = np.zeros((-(-len(rows) // BLOCK) * BLOCK, rows.shape[1]))
    filled[: len(rows)] = rows
    return filled.reshape(-1, BLOCK, rows.shape[1])


def _scale(left: np.ndarray, determined: float) -> float:
    """Return the robust standard deviation per axis; determined is the share of the equations that the fit used up."""
    return max(float(np.median(lengths(left))) / NORMAL_LENGTH / np.sqrt(max(1 - determined, 0.1)), LEAST_SCALE)
