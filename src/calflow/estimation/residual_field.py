"""The residual field: a smooth, non-physical correction of a calibrated model's residuals as a function of the joint readings.

A Gaussian process (Rasmussen and Williams 2006, 2.2, 5.4.1) over the joint readings, scaled by their measured ranges: a squared
exponential kernel with one correlation length per joint, the same for the three coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calflow.files.deferred import pd
from calflow.files.tables import Results, column, typed
from calflow.robot.robot import Robot

NOT_PHYSICAL = "not physical"  # its label wherever it appears
SHORTEST, LONGEST = 0.05, 1.0  # correlation lengths over a joint's measured range: every joint is taken to matter
EDGE = 0.1  # share of a joint's measured range within which the field fades to zero outside it
STILL = 1e-3  # rad or m: a joint that moved less was not moved
LEARNT_FROM = 400  # poses from which the hyperparameters are learnt: time grows with the cube
SMALLEST = 1e-3  # least standard deviation of field and of white noise, as a share of the residuals' root mean square
STARTS = ((0.3, 0.7), (1.0, 0.3))  # starting correlation lengths, and the smooth share of the residuals' variance
JITTER = 1e-9  # share of the smooth variance added to the diagonal
POSES, SUMMARY = "residual_field/poses.csv", "residual_field/summary.json"


@dataclass(frozen=True, eq=False)
class ResidualField:
    """A smooth correction of predicted positions in the measuring frame, not attributed to a cause.

    nodes (n, n_joints) [rad or m]: joint readings of the training poses; left (n, 3) [m]: measured minus predicted positions
    there; length (n_joints,): correlation lengths as parts of the joints' measured ranges; size [m]: prior standard deviation per
    axis; rest [m]: standard deviation of the white part of the residuals; own [m]: its part beyond the device's noise.
    """

    nodes: np.ndarray
    left: np.ndarray
    length: np.ndarray
    size: float
    rest: float
    own: float

    @cached_property
    def low(self) -> np.ndarray:
        """Lowest reading of each joint (n_joints,) [rad or m]."""
        return np.asarray(self.nodes.min(axis=0))

    @cached_property
    def range(self) -> np.ndarray:
        """Measured range of each joint (n_joints,) [rad or m]."""
        return np.asarray(np.maximum(np.ptp(self.nodes, axis=0), STILL))

    def correction(self, readings: np.ndarray) -> np.ndarray:
        """Return the correction of predicted positions at readings (k, n_joints), shape (k, 3) [m], to be added."""
        return np.asarray(self.share(readings)[:, None] * (self._near(readings) @ self._weights))

    def explained(self, readings: np.ndarray) -> np.ndarray:
        """Return how far the field reduces its prior variance per axis (k,) [m²]: nothing beyond the measured ranges."""
        near = self._near(readings)
        known = np.einsum("kn,nk->k", near, scipy.linalg.cho_solve(self._factor, near.T))
        return np.asarray((self.size * self.share(readings)) ** 2 * known)

    def left_of(self, variance: np.ndarray, readings: np.ndarray) -> np.ndarray:
        """Return what the correction leaves of a variance (k, 3) [m²] beyond noise, at least as much as of the prior's."""
        return np.maximum(variance, self.size**2 + self.own**2) - self.explained(readings)[:, None]

    def share(self, readings: np.ndarray) -> np.ndarray:
        """Return the factor (k,) of the correction: 1 within the measured range of every joint, 0 far beyond."""
        beyond = np.maximum(self.low - readings, readings - self.low - self.range) / (EDGE * self.range)
        return np.asarray(np.prod(np.cos(np.pi / 2 * np.clip(beyond, 0.0, 1.0)) ** 2, axis=1))

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        white = (self.rest / self.size) ** 2 + JITTER
        return scipy.linalg.cho_factor(self._near(self.nodes) + white * np.eye(len(self.nodes)), lower=True)

    @cached_property
    def _weights(self) -> np.ndarray:
        return np.asarray(scipy.linalg.cho_solve(self._factor, self.left))

    def _near(self, readings: np.ndarray) -> np.ndarray:
        """Correlation (k, n) of the field at readings with that at the nodes."""
        scale = self.range * self.length
        squared = scipy.spatial.distance.cdist(readings / scale, self.nodes / scale, "sqeuclidean")
        return np.asarray(np.exp(-0.5 * squared))


def learnt(
    nodes: np.ndarray, left: np.ndarray, noise: float, rng: np.random.Generator, beside: np.ndarray | None = None
) -> ResidualField:
    """Return the residual field whose hyperparameters maximise the marginal likelihood.

    Args:
        nodes: distinct joint readings (n, n_joints) [rad or m].
        left: measured minus predicted positions (n, 3) [m].
        noise: standard deviation of the device's noise in left, per axis [m]; 0 where unknown.
        rng: draws the poses from which hyperparameters are learnt, where there are very many.
        beside: effects (n, 3, n_parameters) [m] of the model's parameters at a prior sd, where these are integrated out.
    """
    some = np.sort(rng.permutation(len(nodes))[:LEARNT_FROM])
    scaled = nodes[some] / np.maximum(np.ptp(nodes, axis=0), STILL)
    apart = (scaled[:, None, :] - scaled[None, :, :]) ** 2
    whole = float(np.sqrt(np.mean(left**2)))
    own = np.zeros((len(some), 3, 0)) if beside is None else beside[some] / whole
    n_joints = nodes.shape[1]
    limits = [(np.log(SMALLEST), 1.0)] * 2 + [(np.log(SHORTEST), np.log(LONGEST))] * n_joints
    tried = [
        scipy.optimize.minimize(
            _cost,
            np.array([0.5 * np.log(smooth), 0.5 * np.log(1 - smooth), *np.full(n_joints, np.log(length))]),
            (apart, left[some] / whole, own), jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 60},
        )
        for length, smooth in STARTS
    ]  # fmt: skip
    size, rest, *length = np.exp(min(tried, key=lambda fit: float(fit.fun)).x)
    scatter = float(np.sqrt(max((whole * rest) ** 2 - noise**2, 0.0)))
    return ResidualField(nodes, left, np.array(length), whole * float(size), whole * float(rest), scatter)


def _cost(logs: np.ndarray, apart: np.ndarray, y: np.ndarray, own: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the negative log marginal likelihood of y (n, 3), and its gradient by the log hyperparameters.

    logs holds the logarithms of the standard deviations of field and white part, then of the correlation lengths; apart
    (n, n, n_joints) are squared differences of inputs, own (n, 3, n_parameters) the effect of standard normal parameters.
    """
    size, rest = np.exp(2 * logs[:2])
    inverse = np.exp(-2 * logs[2:])
    smooth = size * np.exp(-0.5 * apart @ inverse)
    covariance = smooth + (rest + JITTER * size) * np.eye(len(y))
    factor = scipy.linalg.cho_factor(covariance, lower=True)
    absorbed, log_root = _absorbed(factor[0], own)
    weights = scipy.linalg.cho_solve(factor, y) - absorbed @ np.einsum("nak,na->k", absorbed, y)
    known = np.einsum("nak,mak->nm", absorbed, absorbed, optimize=True)
    spread = y.shape[1] * scipy.linalg.cho_solve(factor, np.eye(len(y))) - weights @ weights.T - known
    value = 0.5 * float(np.vdot(y, weights)) + y.shape[1] * float(np.log(np.diag(factor[0])).sum()) + log_root
    by_smooth = spread * smooth
    slope = np.array(
        [
            by_smooth.sum() + JITTER * size * np.trace(spread),
            rest * np.trace(spread),
            *(0.5 * inverse * np.einsum("ab,abj->j", by_smooth, apart)),
        ]
    )
    return value, slope


def _absorbed(factor: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, float]:
    """Return what parameters of effect own (n, 3, n_parameters) absorb, beside a Cholesky factor, and their log-determinant."""
    n, _, k = own.shape
    white = scipy.linalg.solve_triangular(factor, own.reshape(n, 3 * k), lower=True)
    along = scipy.linalg.solve_triangular(factor, white, lower=True, trans="T").reshape(3 * n, k)
    # By QR: rounding in the Gram matrix of wide, nearly dependent priors (base and tool) would swallow the identity.
    root = np.asarray(np.linalg.qr(np.vstack([np.eye(k), white.reshape(3 * n, k)]), mode="r")).T
    absorbed = scipy.linalg.solve_triangular(root, along.T, lower=True).T.reshape(own.shape)
    return absorbed, float(np.log(np.abs(np.diag(root))).sum())


@dataclass(frozen=True, kw_only=True)
class FieldPose:
    """A training pose of the residual field, which is not physical; the table is empty where the field is not applied."""

    q: Mapping[str, float] = column("joint readings", name="q{joint}_{deg|mm}")
    left_x_mm: float = column("measured minus predicted position there, along the measuring frame's x", "mm")
    left_y_mm: float = column("the same along y", "mm")
    left_z_mm: float = column("the same along z", "mm")


@dataclass(frozen=True, kw_only=True)
class FieldSummary:
    """The residual field's hyperparameters, and its gain at left-out poses."""

    kind: Literal["not physical"] = column("its kind: not attributed to a cause")
    applied: bool = column(
        "whether predictions and commands include it: only where it gains significantly at left-out poses"
    )
    statement: str = column("the result in a sentence")
    poses: int = column("number of fitted poses that it was learnt from, or would have been")
    blocks: int = column("number of blocks of these that were left out in turn")
    p: float = column("p-value of the gain")
    size_mm: float | None = column("its prior standard deviation per axis; null: not applied", "mm")
    rest_mm: float | None = column("standard deviation per axis of the white part of the residuals", "mm")
    own_mm: float | None = column("the part of it that is not the device's noise", "mm")
    lengths: tuple[float, ...] = column("correlation length for each joint, as a part of its measured range")


@dataclass(frozen=True, kw_only=True)
class FieldAccuracy:
    """Accuracy of predicted positions without and with the residual field, at poses that it was not learnt from."""

    correction: Literal["none", "residual field (not physical)"] = column("what was added to the model's predictions")
    where: Literal["left-out blocks", "holdout"] = column(
        "left-out blocks: of the training rows, seen by the model; holdout: rows that nothing has seen"
    )
    n: int = column("number of poses of the blocks, or rows held out")
    mean_mm: float = column("mean distance", "mm")
    rms_mm: float = column("its root mean square", "mm")
    max_mm: float = column("the largest", "mm")
    covered: float | None = column(
        "share of the coordinates within their 95 % intervals, the device's noise included; of blocks with it alone"
    )


def pose_table(field: ResidualField | None, robot: Robot) -> pd.DataFrame:
    """Return the table of `FieldPose`s."""
    n = robot.n_joints
    nodes, left = (field.nodes, field.left) if field else (np.zeros((0, n)), np.zeros((0, 3)))
    columns = dict(zip(_names(robot), (nodes * _factors(robot)).T, strict=True))
    return typed(pd.DataFrame(columns | {f"left_{a}_mm": 1e3 * left[:, k] for k, a in enumerate("xyz")}), FieldPose)


def read_field(results: Results, robot: Robot) -> ResidualField | None:
    """Return the field that the results hold; None where they hold none, or it is not applied."""
    if SUMMARY not in results:
        return None
    summary = results.document(SUMMARY, FieldSummary)
    if not summary.applied or summary.size_mm is None or summary.rest_mm is None or summary.own_mm is None:
        return None
    table = results.tables[POSES]
    nodes = table[_names(robot)].to_numpy(dtype=float) / _factors(robot)
    left = table[["left_x_mm", "left_y_mm", "left_z_mm"]].to_numpy(dtype=float) / 1e3
    return ResidualField(
        nodes, left, np.array(summary.lengths), summary.size_mm / 1e3, summary.rest_mm / 1e3, summary.own_mm / 1e3
    )


def _names(robot: Robot) -> Sequence[str]:
    return [f"q{i + 1}_{joint.shown[0]}" for i, joint in enumerate(robot.joints)]


def _factors(robot: Robot) -> np.ndarray:
    return np.array([joint.shown[1] for joint in robot.joints])
