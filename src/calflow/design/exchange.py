"""Exact designs: poses added and exchanged one at a time, each by a low-rank update of what all candidates are worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calflow.design.optimality import Criterion

EXCHANGE_PASSES = 20
SMALLEST_GAIN = 1e-6  # share of a pose's own worth: swaps that gain less are rounding


def greedy(jacobians: np.ndarray, prior: np.ndarray, number: int, criterion: Criterion) -> list[int]:
    """Return the candidates that lower the loss most, one after the other.

    jacobians (n_candidates, n_axes, n_parameters) are whitened, prior (n_parameters, n_parameters) is the information
    before any pose.
    """
    basis = _basis(jacobians, prior, [], criterion)
    chosen: list[int] = []
    for _ in range(number):
        best = _best(jacobians, basis, chosen, criterion)[0]
        chosen.append(best)
        basis = _changed(basis, jacobians[best], basis[best], +1)
    return chosen


def exchange(jacobians: np.ndarray, prior: np.ndarray, chosen: Sequence[int], criterion: Criterion) -> list[int]:
    """Swap chosen poses for better candidates until no swap lowers the loss (Fedorov 1972, one pose at a time)."""
    chosen = list(chosen)
    for _ in range(EXCHANGE_PASSES):
        swapped = False
        basis = _basis(jacobians, prior, chosen, criterion)  # anew, so that rounding does not add up
        for k, old in enumerate(chosen):
            without = _changed(basis, jacobians[old], basis[old], -1)
            best, gains = _best(jacobians, without, [*chosen[:k], *chosen[k + 1 :]], criterion)
            if gains[best] > (1 + SMALLEST_GAIN) * gains[old]:
                chosen[k] = best
                swapped = True
                basis = _changed(without, jacobians[best], without[best], +1)
        if not swapped:
            break
    return chosen


def information(jacobians: np.ndarray, prior: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the information of poses (n_poses, n_axes, n_parameters), each so many times, and the prior."""
    weighted = jacobians * np.sqrt(np.broadcast_to(weights, len(jacobians)))[:, None, None]
    flat = weighted.reshape(-1, jacobians.shape[2])
    return np.asarray(prior + flat.T @ flat)


def _best(
    jacobians: np.ndarray, basis: np.ndarray, taken: Sequence[int], criterion: Criterion
) -> tuple[int, np.ndarray]:
    """Return the candidate that is worth most, none of those taken, and what each is worth."""
    n = jacobians.shape[2]
    gains = criterion.gains(basis[:, :, :n] @ jacobians.transpose(0, 2, 1), basis[:, :, n:])
    gains[list(taken)] = -np.inf
    return int(np.argmax(gains)), gains


def _basis(jacobians: np.ndarray, prior: np.ndarray, chosen: Sequence[int], criterion: Criterion) -> np.ndarray:
    """J C [I, root] of all candidates, C being the covariance with the chosen poses, (n, n_axes, n_parameters + r)."""
    covariance = np.linalg.inv(information(jacobians[list(chosen)], prior))
    return np.asarray(jacobians @ np.hstack([covariance, covariance @ criterion.root]))


def _changed(basis: np.ndarray, pose: np.ndarray, gain: np.ndarray, sign: int) -> np.ndarray:
    """The basis after a pose (n_axes, n_parameters) came (+1) or went (-1): C changes by rank n_axes (Woodbury)."""
    n = pose.shape[1]
    inner = np.linalg.solve(np.eye(len(pose)) + sign * gain[:, :n] @ pose.T, gain)
    flat = basis.reshape(-1, basis.shape[2])  # one product of large matrices, where numpy would make one a candidate
    change = (flat[:, :n] @ pose.T) @ (-sign * inner)
    change += flat
    return np.asarray(change.reshape(basis.shape))
