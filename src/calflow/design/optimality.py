"""Optimality: criteria of experimental design, as observability indices and as losses to minimise.

A criterion is a function of the parameters' covariance C, the inverse of the prior's plus the poses' information. It has a root of
the parameters' weight matrix (n_parameters, r), with r = 0 where all count alike; the power of the sensitivities with which the
multiplicative algorithm converges monotonically; the loss to be minimised; the slope F (n_parameters, r), |J F|² being the
sensitivity of the loss to the information JᵀJ of a pose; and the gains (n,) by candidates that augment a design.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calflow.design.augmentation import Augmentation

RANK = 1e-12  # share of the largest eigenvalue below which a direction of the parameters does not move the tool


def indices(jacobian: np.ndarray, rank: int) -> np.ndarray:
    """Return the observability indices O1 … O5 of a scaled Jacobian (n_rows, n_parameters) with this rank.

    With singular values s1 >= … >= sr and m poses of three rows: O1 their geometric mean over sqrt(m) (Borm and Menq 1991,
    D-optimal), O2 = sr / s1 (Driels and Pathre 1990), O3 = sr (Nahvi et al. 1994, E-optimal), O4 = sr² / s1 (Nahvi and
    Hollerbach 1996, noise amplification), O5 = 1 / sum(1/s) (Sun and Hollerbach 2008, A-optimal). Numbering as there.
    """
    s = np.linalg.svd(jacobian, compute_uv=False)[:rank]
    if len(s) < rank or s[-1] <= 0:
        return np.zeros(5)
    poses = len(jacobian) / 3
    return np.array(
        [np.exp(np.log(s).mean()) / np.sqrt(poses), s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1 / (1 / s).sum()]
    )


def information(jacobians: np.ndarray, prior: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the information matrix of weighted poses (n_poses, n_axes, n_parameters) and the prior."""
    weighted = jacobians * np.sqrt(np.broadcast_to(weights, len(jacobians)))[:, None, None]
    flat = weighted.reshape(-1, jacobians.shape[2])
    return np.asarray(prior + flat.T @ flat)


@dataclass(frozen=True, eq=False)
class ParameterCriterion:
    """D-optimality: the loss is the geometric mean of n parameters' standard deviations, det(C)^(1/2n), the inverse of O1."""

    n: int
    power = 1.0

    @property
    def root(self) -> np.ndarray:
        """Empty: all parameters count alike."""
        return np.empty((self.n, 0))

    def loss(self, covariance: np.ndarray) -> float:
        """Return the geometric mean of the standard deviations along the covariance's own axes."""
        return float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * self.n)))

    def slope(self, covariance: np.ndarray) -> np.ndarray:
        """Return a root of the covariance: log det M grows by the trace of J C Jᵀ."""
        return np.asarray(np.linalg.cholesky(covariance))

    def gains(self, added: Augmentation) -> np.ndarray:
        """Return how much the logarithm of the information's determinant grows."""
        return np.asarray(np.linalg.slogdet(np.eye(added.inside.shape[1]) + added.inside)[1])


@dataclass(frozen=True, eq=False)
class ToolError:
    """I-optimality: the loss is the root mean square of the tool's standard deviation [m] over task points.

    slopes (n_points, 3, n_parameters): Jacobian of the predicted tool; shares (n_points,): weights of the points, which
    sum to 1. The test poses of Klimchik et al. 2012 are this criterion with a few points.
    """

    slopes: np.ndarray
    shares: np.ndarray
    power = 0.5

    @cached_property
    def root(self) -> np.ndarray:
        """A root R of the mean of the points' slopes squared, so that the loss is the root of trace(Rᵀ C R)."""
        flat = (self.slopes * np.sqrt(self.shares)[:, None, None]).reshape(-1, self.slopes.shape[2])
        values, vectors = np.linalg.eigh(flat.T @ flat)
        kept = values > RANK * values[-1]
        return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))

    def variances(self, covariance: np.ndarray) -> np.ndarray:
        """Return the variance [m²] of the predicted tool at each point, all three axes, shape (n_points,)."""
        return np.asarray(((self.slopes @ np.linalg.cholesky(covariance)) ** 2).sum(axis=(1, 2)))

    def loss(self, covariance: np.ndarray) -> float:
        """Return the root mean square of the tool's standard deviation [m]."""
        return float(np.sqrt(np.sum(self.root * (covariance @ self.root))))

    def slope(self, covariance: np.ndarray) -> np.ndarray:
        """Return C R: the mean variance falls by the trace of J C R Rᵀ C Jᵀ."""
        return covariance @ self.root

    def gains(self, added: Augmentation) -> np.ndarray:
        """Return by how much the mean variance [m²] falls."""
        return added.explained()


Criterion = ParameterCriterion | ToolError
