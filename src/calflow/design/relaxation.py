"""The relaxed design, in which poses may be taken in part, and the bound that it proves on every choice of whole poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.design.exchange import information
from calflow.design.optimality import Criterion

CLOSE = 1e-3  # gap of the squared loss to its bound at which the relaxed design counts as found
ROUNDS = 60
STEPS = 200  # of the multiplicative algorithm in a round
FIRST, ADDED = 500, 300  # candidates that a design begins with, and those that join it in a round
NEGLIGIBLE = 1e-5  # share of a pose that leaves the design
BLOCK = 4096  # candidates at once


@dataclass(frozen=True, eq=False)
class Relaxed:
    """How much of each candidate to take, each at most once, shape (n_candidates,), and what that proves.

    sensitivity (n_candidates,) is how fast the loss falls with each candidate; bound is a loss that no choice of as many whole
    poses gets below.
    """

    weights: np.ndarray
    sensitivity: np.ndarray
    bound: float


def relaxed(
    jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion, start: np.ndarray | None = None
) -> Relaxed:
    """Return the best relaxed design of so many poses, and the best bound that was met on the way to it.

    The way begins at the weights `start`, else anywhere. It is Torsney's multiplicative algorithm (1983) over a few hundred
    candidates, which those join of all that would lower the loss most, until the equivalence theorem (Kiefer and Wolfowitz
    1960) says that none would by more than a thousandth.
    """
    n = len(jacobians)
    first = min(n, max(FIRST, 3 * number))
    active = np.linspace(0, n - 1, first).astype(int) if start is None else np.flatnonzero(start)
    weights = np.full(first, number / first) if start is None else start[active]
    best = 0.0
    for _ in range(ROUNDS):
        weights, covariance = _settled(jacobians[active], prior, number, weights, criterion)
        slope = criterion.slope(covariance)
        sensitivity = sensitivities(jacobians, slope)
        level = criterion.loss(covariance)
        found = level * np.sqrt(_reached(slope, covariance) / _most(slope, prior, sensitivity, number))
        best = max(best, found)
        if (level / found) ** 2 < 1 + CLOSE:
            break
        kept = weights > NEGLIGIBLE
        joining = np.setdiff1d(np.argsort(sensitivity)[-ADDED:], active[kept])
        started = np.full(len(joining), NEGLIGIBLE * number)
        active = np.concatenate([active[kept], joining])
        weights = _capped(np.concatenate([weights[kept], started]), number)
    everywhere = np.zeros(n)
    everywhere[active] = weights
    return Relaxed(everywhere, sensitivity, best)


def sensitivities(jacobians: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return |J F|² of each candidate, shape (n_candidates,), in blocks that fit into the processor's cache."""
    found = np.empty(len(jacobians))
    for start in range(0, len(jacobians), BLOCK):
        part = jacobians[start : start + BLOCK]
        moved = part.reshape(-1, part.shape[2]) @ slope
        found[start : start + BLOCK] = (moved.reshape(len(part), -1) ** 2).sum(axis=1)
    return found


def _settled(
    jacobians: np.ndarray, prior: np.ndarray, number: int, weights: np.ndarray, criterion: Criterion
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of these candidates after some steps, and the covariance that they leave."""
    covariance = np.linalg.inv(information(jacobians, prior, weights))
    for _ in range(STEPS):
        slope = criterion.slope(covariance)
        sensitivity = sensitivities(jacobians, slope)
        if _most(slope, prior, sensitivity, number) < (1 + CLOSE / 2) * _reached(slope, covariance):
            break
        weights = _capped(weights * sensitivity**criterion.power, number)
        covariance = np.linalg.inv(information(jacobians, prior, weights))
    return weights, covariance


def _reached(slope: np.ndarray, covariance: np.ndarray) -> float:
    """trace(Fᵀ M F) of a design's own information M."""
    return float(np.sum(slope * np.linalg.solve(covariance, slope)))


def _most(slope: np.ndarray, prior: np.ndarray, sensitivity: np.ndarray, number: int) -> float:
    """The most that trace(Fᵀ M' F) can be with the information M' of any so many candidates.

    The loss of these is at least the design's, times the root of what it reaches over this: det(M⁻¹M') is at most the p-th
    power of its mean eigenvalue, and trace(A C') trace(C A C M') at least the square of trace(A C) (Cauchy and Schwarz).
    """
    return float(np.sum(slope * (prior @ slope)) + np.partition(sensitivity, -number)[-number:].sum())


def _capped(shares: np.ndarray, number: int) -> np.ndarray:
    """Return shares scaled to add up to a number, none above 1."""
    shares = np.maximum(shares, 1e-12 * shares.max())
    falling = np.sort(shares)[::-1]
    rest = np.cumsum(falling[::-1])[::-1]
    full = np.arange(len(shares))
    scale = (number - full[:number]) / rest[:number]  # where so many are taken whole
    fits = scale * falling[:number] <= 1
    return (
        np.minimum(1.0, scale[np.argmax(fits)] * shares)
        if fits.any()
        else np.minimum(1.0, shares / falling[number - 1])
    )
