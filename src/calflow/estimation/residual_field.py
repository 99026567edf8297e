"""The residual field: a smooth function of the joint readings for what a calibrated model leaves. It is not physical.

A Gaussian process (Rasmussen and Williams 2006, 2.2, 5.4.1) over the readings, each over its measured range: a squared
exponential kernel with a length a joint, the same for the three coordinates. What no rows are near it knows nothing of:
beyond the measured range of any joint it fades to nothing, and its standard deviation rises to what was left unexplained.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

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
        known = np.einsum("kn,nk->k", near, cho_solve(self._factor, near.T))
        return np.asarray(self.size**2 - self.share(readings) ** 2 * known + self.own**2)

    def share(self, readings: np.ndarray) -> np.ndarray:
        """Return how much of the field counts (k,): all within the measured range of every joint, nothing far beyond."""
        beyond = np.maximum(self.low - readings, readings - self.low - self.range) / (EDGE * self.range)
        return np.asarray(np.prod(np.cos(np.pi / 2 * np.clip(beyond, 0.0, 1.0)) ** 2, axis=1))

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        covariance = self._near(self.nodes)
        covariance[np.diag_indices_from(covariance)] += self.rest**2 + JITTER * self.size**2
        return cho_factor(covariance, lower=True)

    @cached_property
    def _weights(self) -> np.ndarray:
        return np.asarray(cho_solve(self._factor, self.left))

    def _near(self, readings: np.ndarray) -> np.ndarray:
        """The covariance (k, n) [m²] of the field at readings and at the nodes."""
        scale = self.range * self.length
        return np.asarray(self.size**2 * np.exp(-0.5 * cdist(readings / scale, self.nodes / scale, "sqeuclidean")))


def learnt(nodes: np.ndarray, left: np.ndarray, noise: float, spent: float, rng: np.random.Generator) -> ResidualField:
    """Return the field of what is left (n, 3) [m] at readings (n, n_joints), of the greatest marginal likelihood.

    Args:
        nodes: joint readings, no two alike [rad, or m].
        left: measured minus predicted positions.
        noise: standard deviation of the device's noise in these, per axis [m]; 0 where it is not known.
        spent: share of what was left that the model's parameters took up when they were fitted: what is left elsewhere is
            larger by as much.
        rng: of the poses from which lengths and sizes are learnt, where there are very many.
    """
    some = np.sort(rng.permutation(len(nodes))[:LEARNT_FROM])
    scaled = nodes[some] / np.maximum(np.ptp(nodes, axis=0), STILL)
    apart = (scaled[:, None, :] - scaled[None, :, :]) ** 2
    whole = float(np.sqrt(np.mean(left**2)))
    y = left[some] / whole
    n_joints = nodes.shape[1]
    limits = [(np.log(SMALLEST), 1.0)] * 2 + [(np.log(SHORTEST), np.log(LONGEST))] * n_joints
    tried = [
        minimize(
            _unlikely,
            np.array([0.5 * np.log(smooth), 0.5 * np.log(1 - smooth), *np.full(n_joints, np.log(length))]),
            (apart, y), jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 60},
        )
        for length, smooth in STARTS
    ]  # fmt: skip
    size, rest, *length = np.exp(min(tried, key=lambda one: float(one.fun)).x)
    lost = np.sqrt(1 / max(1 - spent, 0.5))
    rest_alone = lost * whole * float(rest)
    own = float(np.sqrt(max(rest_alone**2 - noise**2, 0.0)))
    return ResidualField(nodes, left, np.array(length), lost * whole * float(size), rest_alone, own)


def _unlikely(asked: np.ndarray, apart: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the logarithm of the marginal likelihood of y (n, 3), and its derivatives, by the logarithms asked for.

    These are the sizes of field and rest, then the lengths; apart (n, n, n_joints) are squared differences of inputs.
    """
    size, rest = np.exp(2 * asked[:2])
    inverse = np.exp(-2 * asked[2:])
    smooth = size * np.exp(-0.5 * apart @ inverse)
    covariance = smooth + (rest + JITTER * size) * np.eye(len(y))
    factor = cho_factor(covariance, lower=True)
    weights = cho_solve(factor, y)
    spread = y.shape[1] * cho_solve(factor, np.eye(len(y))) - weights @ weights.T
    value = 0.5 * float(np.vdot(y, weights)) + y.shape[1] * float(np.log(np.diag(factor[0])).sum())
    by_smooth = spread * smooth
    slope = np.array(
        [
            by_smooth.sum() + JITTER * size * np.trace(spread),
            rest * np.trace(spread),
            *(0.5 * inverse * np.einsum("ab,abj->j", by_smooth, apart)),
        ]
    )
    return value, slope
