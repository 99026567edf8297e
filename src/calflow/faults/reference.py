"""The reference for data faults: a rough robot fitted to the training rows so that wrong rows hardly count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.effects.base import unmet
from calflow.measurements import Measurements
from calflow.model import Model, build
from calflow.robot.description import Base, Robot
from calflow.stages.noise import conditions
from calflow.stages.registration import Placement

FIT_ROWS = 400  # training rows that are fitted: more would hardly tell more
EQUATIONS = 2.0  # a parameter: with fewer some rows are met exactly whatever they hold, and others look gross
PLACED_SD = 0.5  # m and rad: where base and tool are is left to the data
NORMAL_LENGTH = 1.5382  # median length of a vector of three unit normals
WIDTH = 2.5  # robust standard deviations at which a row counts half
LINEARISED, REWEIGHTED = 6, 8  # rounds of the fit, and in each of the weights
SETTLED = 0.02  # standard deviations by which the last round moves a row
TINY = 1e-9  # m: below it errors are rounding

# Errors are told apart by robust standard deviations of the training rows (1.48 median deviations, for three axes). Normal
# noise passes 6 in no data set, Student's t with 3 degrees of freedom passes 15 in one row of a thousand. A row may be
# mended at 15, since then a definite mistake must also bring it back among the others; see outlier.py for rows that
# nothing explains. What is gross is more than a robot's physics does to single rows, so at least half a millimetre.
GROSS, LEAST_GROSS = 15.0, 5e-4
FAR_BETTER = 5.0  # times by which a mistake, once put right, must lessen a row's error


@dataclass(frozen=True)
class Rough:
    """A robust fit: scale is the robust standard deviation per axis [m] of the rows it was fitted to.

    covariance (n_parameters, n_parameters) is that of the estimate for errors of that scale.
    """

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    scale: float

    @property
    def gross(self) -> float:
        """The error [m] from which a row is gross."""
        return max(GROSS * self.scale, LEAST_GROSS)

    def predicted(self, rows: np.ndarray) -> np.ndarray:
        """Return positions (n_rows, 3) [m] for packed conditions; nan where a loop cannot be closed."""
        return self.model.position(self.estimate, rows)

    def miss(self, data: Measurements) -> np.ndarray:
        """Return how far each row's position is from where the others say it should be, shape (n_rows,) [m]."""
        return lengths(data.position - self.predicted(data.rows))

    def uncertainty(self, rows: np.ndarray) -> np.ndarray:
        """Return how much larger than a fitted row's a row's error may be, since the fit itself is unsure there."""
        jacobian = self.model.position_jacobian(self.estimate, rows)
        variance = np.einsum("nai,ij,naj->na", jacobian, self.covariance, jacobian, optimize=True)
        return np.sqrt(1 + variance.max(axis=1) / max(self.scale, TINY) ** 2)

    def better(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Whether errors (…) [m] fall from gross to what the other rows have."""
        return (before > self.gross) & (after < np.minimum(self.gross, before / FAR_BETTER))


@dataclass(frozen=True)
class Reference:
    """What the rows of a data set say of one another; each part is worked out when first asked for."""

    data: Measurements

    @cached_property
    def train(self) -> Measurements:
        """The training rows to be fitted, evenly over all there are."""
        train = np.flatnonzero(self.data.train)
        return self.data.only(chosen(train, FIT_ROWS, len(self.data)))

    @cached_property
    def spread(self) -> float:
        """Median distance [m] of the training rows from their middle."""
        return float(np.median(lengths(self.train.position - np.median(self.train.position, axis=0))))

    @cached_property
    def robot(self) -> Robot:
        """The robot with its base where the training rows put it, all else as its maker says."""
        return stood(self.data.robot, self.train)

    @cached_property
    def fit(self) -> Rough | None:
        """The richest robot that the rows are enough for: with springs, without, or only placed; None for a handful."""
        robot, given, train = self.robot, self.data.given, self.train.on(self.robot)
        equations = 3 * len(np.unique(conditions(train)))
        springs = "gravity-deflection" if unmet(("masses",), robot, given) else "joint-compliance"
        for effects in (("geometry", springs), ("geometry",), ()):
            model = build(robot, effects, given) if effects else placement(robot, given)
            if EQUATIONS * len(model.parameters) <= equations:
                return rough(model, train.rows, train.position)
        return None


def rough(model: Model, rows: np.ndarray, measured: np.ndarray) -> Rough:
    """Fit a model to positions (n_rows, 3) by least squares in which wrong rows weigh little (Cauchy).

    The noise is the scale of the errors themselves, taken anew with the weights. The model is linearised until it settles.
    """
    prior = model.prior_sd.copy()
    placed = [k for k, p in enumerate(model.parameters) if p.part == "base" or p.part in model.robot.markers]
    prior[placed] = PLACED_SD
    estimate, n = model.nominal.copy(), len(model.parameters)
    for _ in range(LINEARISED):
        jacobian = model.position_jacobian(estimate, rows)
        left = measured - model.position(estimate, rows)
        there = np.isfinite(left).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        jacobian, left = jacobian[there], left[there]
        scaled = (jacobian * prior).reshape(left.size, n)
        step, scale = np.zeros(n), _scale(left, 0.0)
        for _ in range(REWEIGHTED):
            error = lengths(left - (scaled @ step).reshape(left.shape))
            weight = np.repeat(1 / (1 + (error / (WIDTH * scale)) ** 2) / scale**2, 3)
            data_only = scaled.T @ (weight[:, None] * scaled)
            information = data_only + np.eye(n)
            gradient = scaled.T @ (weight * left.ravel()) - (estimate - model.nominal) / prior
            step = np.linalg.solve(information, gradient)
            determined = np.trace(np.linalg.solve(information, data_only)) / left.size
            scale = _scale(left - (scaled @ step).reshape(left.shape), determined)
        estimate = estimate + step * prior
        if np.abs(scaled @ step).max(initial=0.0) < SETTLED * scale:
            break
    covariance = np.linalg.inv(information) * np.outer(prior, prior)
    return Rough(model, estimate, covariance, scale)


def placement(robot: Robot, given: tuple[str, ...]) -> Model:
    """Return the model whose only unknowns are where base and tool are."""
    return Model(robot, (Placement(robot),), given)


def stood(robot: Robot, train: Measurements) -> Robot:
    """Return the robot with its base where the points of the nominal robot come closest to the measured ones."""
    nominal = build(at_origin(robot), (), train.given)
    points = nominal.position(nominal.nominal, train.rows)
    turn, shift, _ = motion(points, train.position)
    rx, ry, rz = (float(angle) for angle in Rotation.from_matrix(turn).as_euler("XYZ"))
    x, y, z = (float(value) for value in shift)
    base = Base.model_construct(origin=(x, y, z), rotation=(rx, ry, rz), known=False)
    return robot.model_copy(update={"base": base})


def at_origin(robot: Robot) -> Robot:
    """Return the robot with its base in the measuring frame's origin."""
    return robot.model_copy(update={"base": Base(known=False)})


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
        turn = best_turn(np.einsum("...n,...ni,...nj->...ij", weight, wanted, apart, optimize=True))
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


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (…) of vectors (…, 3); infinite where one is not a number."""
    return np.nan_to_num(np.sqrt((vectors**2).sum(axis=-1)), nan=np.inf)


def chosen(rows: np.ndarray, most: int, total: int) -> np.ndarray:
    """Return a mask (total,) of at most so many of the rows, evenly spread."""
    mask = np.zeros(total, dtype=bool)
    mask[rows[np.unique(np.linspace(0, len(rows) - 1, most).astype(int))] if len(rows) > most else rows] = True
    return mask


def changed(data: Measurements, column: int, values: np.ndarray, rows: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the packed conditions (n_conditions, n) of some rows with other readings of a joint (index from 0)."""
    packed = data.rows[:, rows].copy()
    packed[column] = values
    return packed


def _scale(left: np.ndarray, determined: float) -> float:
    """Return the robust standard deviation per axis; determined is the share of the equations that the fit used up."""
    return max(float(np.median(lengths(left))) / NORMAL_LENGTH / np.sqrt(max(1 - determined, 0.1)), TINY)
