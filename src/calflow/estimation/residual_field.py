"""The residual field: a smooth function of the joint readings for what a calibrated model leaves. It is not physical.

A Gaussian process (Rasmussen and Williams 2006, 2.2, 5.4.1) over the readings, each over its measured range: a squared
exponential kernel with a length a joint, the same for the three coordinates. What no rows are near it knows nothing of:
beyond the measured range of any joint it fades to nothing, and its standard deviation rises to what was left unexplained.

The residual field as a run folder keeps it: what it was learnt from as a table, its figures and its gain as a document.
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

NOT_PHYSICAL = "not physical"  # what it is called wherever it appears
SHORTEST, LONGEST = 0.05, 1.0  # of a joint's measured range: no joint is taken not to matter
EDGE = 0.1  # of a joint's measured range, beyond which nothing is left of the field
STILL = 1e-3  # rad or m: a joint that moved less was not moved
LEARNT_FROM = 400  # poses from which the lengths and sizes are learnt: time grows with the cube
SMALLEST = 1e-3  # of all that is left: the least that is taken to be smooth, and to be noise
STARTS = ((0.3, 0.7), (1.0, 0.3))  # lengths, and the smooth share of what is left
JITTER = 1e-9  # of the smooth variance


@dataclass(frozen=True, eq=False)
class ResidualField:
    """A smooth correction that no cause explains, for positions in the measuring frame.

    nodes (n, n_joints) are joint readings [rad, or m] and left (n, 3) [m] is measured minus predicted there. length (n_joints,)
    is in parts of a joint's measured range, size [m] the field's standard deviation per axis before anything is measured, rest
    [m] that of what is not smooth, and own [m] the part of the rest that is not the device's noise.
    """

    nodes: np.ndarray
    left: np.ndarray
    length: np.ndarray
    size: float
    rest: float
    own: float

    @cached_property
    def low(self) -> np.ndarray:
        """The lowest reading of each joint (n_joints,)."""
        return np.asarray(self.nodes.min(axis=0))

    @cached_property
    def range(self) -> np.ndarray:
        """How far each joint was moved (n_joints,)."""
        return np.asarray(np.maximum(np.ptp(self.nodes, axis=0), STILL))

    def correction(self, readings: np.ndarray) -> np.ndarray:
        """Return what is to be added to predicted positions at readings (k, n_joints), shape (k, 3) [m]."""
        smooth = self._near(readings) @ self._weights
        return np.asarray(self.share(readings)[:, None] * smooth)

    def variance(self, readings: np.ndarray) -> np.ndarray:
        """Return the variance per axis (k,) [m²] of what is left with the correction, the device's noise apart.

        Beyond the measured ranges it is that of all that was left without it.
        """
        near = self._near(readings)
        explained = np.einsum("kn,nk->k", near, scipy.linalg.cho_solve(self._factor, near.T))
        return np.asarray(self.size**2 - self.share(readings) ** 2 * explained + self.own**2)

    def share(self, readings: np.ndarray) -> np.ndarray:
        """Return how much of the field counts (k,): all within the measured range of every joint, nothing far beyond."""
        beyond = np.maximum(self.low - readings, readings - self.low - self.range) / (EDGE * self.range)
        return np.asarray(np.prod(np.cos(np.pi / 2 * np.clip(beyond, 0.0, 1.0)) ** 2, axis=1))

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        covariance = self._near(self.nodes)
        covariance[np.diag_indices_from(covariance)] += self.rest**2 + JITTER * self.size**2
        return scipy.linalg.cho_factor(covariance, lower=True)

    @cached_property
    def _weights(self) -> np.ndarray:
        return np.asarray(scipy.linalg.cho_solve(self._factor, self.left))

    def _near(self, readings: np.ndarray) -> np.ndarray:
        """The covariance (k, n) [m²] of the field at readings and at the nodes."""
        scale = self.range * self.length
        squared = scipy.spatial.distance.cdist(readings / scale, self.nodes / scale, "sqeuclidean")
        return np.asarray(self.size**2 * np.exp(-0.5 * squared))


def learnt(
    nodes: np.ndarray,
    left: np.ndarray,
    noise: float,
    spent: float,
    rng: np.random.Generator,
    beside: np.ndarray | None = None,
) -> ResidualField:
    """Return the field of what is left (n, 3) [m] at readings (n, n_joints), of the greatest marginal likelihood.

    Args:
        nodes: joint readings, no two alike [rad, or m].
        left: measured minus predicted positions.
        noise: standard deviation of the device's noise in these, per axis [m]; 0 where it is not known.
        spent: share of what was left that the model's parameters took up when they were fitted: what is left elsewhere is
            larger by as much.
        rng: of the poses from which lengths and sizes are learnt, where there are very many.
        beside: what a model's own parameters move, each by its standard deviation before any data (n, 3, n_parameters) [m], where
            they are to be integrated out.
    """
    some = np.sort(rng.permutation(len(nodes))[:LEARNT_FROM])
    scaled = nodes[some] / np.maximum(np.ptp(nodes, axis=0), STILL)
    apart = (scaled[:, None, :] - scaled[None, :, :]) ** 2
    whole = float(np.sqrt(np.mean(left**2)))
    y = left[some] / whole
    own = np.zeros((*y.shape, 1)) if beside is None else beside[some] / whole
    n_joints = nodes.shape[1]
    limits = [(np.log(SMALLEST), 1.0)] * 2 + [(np.log(SHORTEST), np.log(LONGEST))] * n_joints
    tried = [
        scipy.optimize.minimize(
            _unlikely,
            np.array([0.5 * np.log(smooth), 0.5 * np.log(1 - smooth), *np.full(n_joints, np.log(length))]),
            (apart, y, own), jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 60},
        )
        for length, smooth in STARTS
    ]  # fmt: skip
    size, rest, *length = np.exp(min(tried, key=lambda fit: float(fit.fun)).x)
    lost = np.sqrt(1 / max(1 - spent, 0.5))
    rest_alone = lost * whole * float(rest)
    scatter = float(np.sqrt(max(rest_alone**2 - noise**2, 0.0)))
    return ResidualField(nodes, left, np.array(length), lost * whole * float(size), rest_alone, scatter)


def _unlikely(asked: np.ndarray, apart: np.ndarray, y: np.ndarray, own: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the logarithm of the marginal likelihood of y (n, 3), and its derivatives, by the logarithms asked for.

    These are the sizes of field and rest, then the lengths; apart (n, n, n_joints) are squared differences of inputs, own
    (n, 3, n_parameters) what standard normal parameters move beside both.
    """
    size, rest = np.exp(2 * asked[:2])
    inverse = np.exp(-2 * asked[2:])
    smooth = size * np.exp(-0.5 * apart @ inverse)
    covariance = smooth + (rest + JITTER * size) * np.eye(len(y))
    factor = scipy.linalg.cho_factor(covariance, lower=True)
    along = scipy.linalg.cho_solve(factor, own.reshape(len(y), -1)).reshape(own.shape)
    told = np.linalg.cholesky(np.eye(own.shape[2]) + np.einsum("nak,nal->kl", own, along))
    taken = scipy.linalg.solve_triangular(told, along.reshape(-1, len(told)).T, lower=True).T.reshape(own.shape)
    weights = scipy.linalg.cho_solve(factor, y) - taken @ np.einsum("nak,na->k", taken, y)
    spread = y.shape[1] * scipy.linalg.cho_solve(factor, np.eye(len(y))) - weights @ weights.T
    spread -= np.einsum("nak,mak->nm", taken, taken, optimize=True)
    value = 0.5 * float(np.vdot(y, weights)) + y.shape[1] * float(np.log(np.diag(factor[0])).sum())
    value += float(np.log(np.diag(told)).sum())
    by_smooth = spread * smooth
    slope = np.array(
        [
            by_smooth.sum() + JITTER * size * np.trace(spread),
            rest * np.trace(spread),
            *(0.5 * inverse * np.einsum("ab,abj->j", by_smooth, apart)),
        ]
    )
    return value, slope


POSES, SUMMARY = "residual_field/poses.csv", "residual_field/summary.json"


@dataclass(frozen=True, kw_only=True)
class FieldPose:
    """A pose that the residual field, which is not physical, was learnt from; a header alone where it is not applied."""

    q: Mapping[str, float] = column("joint readings", name="q{joint}_{deg|mm}")
    left_x_mm: float = column("measured minus predicted position there, along the measuring frame's x", "mm")
    left_y_mm: float = column("the same along y", "mm")
    left_z_mm: float = column("the same along z", "mm")


@dataclass(frozen=True, kw_only=True)
class FieldSummary:
    """The residual field's figures, and what it gains."""

    kind: Literal["not physical"] = column("what it is: no cause explains it")
    applied: bool = column("whether predictions and commands have it: only where it gains something at left-out poses")
    statement: str = column("the same in a sentence")
    poses: int = column("number of fitted poses that it was learnt from, or would have been")
    blocks: int = column("number of blocks of these that were left out in turn")
    rms_without_mm: float | None = column("rms distance at left-out poses without it; null: too few poses", "mm")
    rms_corrected_mm: float | None = column("the same with it, learnt from the others", "mm")
    p: float = column("chance of so much where nothing is gained")
    covered: float | None = column("share of left-out coordinates within their 95 % intervals")
    size_mm: float | None = column(
        "its standard deviation per axis where nothing was measured; null: not applied", "mm"
    )
    rest_mm: float | None = column("standard deviation per axis of what is left and not smooth", "mm")
    own_mm: float | None = column("the part of it that is not the device's noise", "mm")
    lengths: tuple[float, ...] = column("over which it changes, a joint, as parts of the measured range")


@dataclass(frozen=True, kw_only=True)
class FieldAccuracy:
    """How far predictions are from positions, without the residual field and with it, at poses that it has not seen."""

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
    """Rebuild the field; None where the results have none, or it is not applied."""
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
