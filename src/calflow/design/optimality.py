"""Observability: how well a set of poses determines the parameters, and which poses do it best."""

from __future__ import annotations

import numpy as np

EXCHANGE_PASSES = 20
SMALLEST_GAIN = 1e-6  # in log det: swaps that gain less are rounding


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


def greedy(jacobians: np.ndarray, prior: np.ndarray, number: int) -> list[int]:
    """Return the candidates that raise the information's determinant most, one after the other.

    jacobians (n_candidates, n_axes, n_parameters) are whitened, prior (n_parameters, n_parameters) is the information
    before any pose.
    """
    covariance = np.linalg.inv(prior)
    gain_basis = jacobians @ covariance
    chosen: list[int] = []
    for _ in range(number):
        gains = _gains(jacobians, gain_basis)
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        chosen.append(best)
        gain_basis = _updated(gain_basis, jacobians[best], gain_basis[best])
    return chosen


def exchange(jacobians: np.ndarray, prior: np.ndarray, chosen: list[int]) -> list[int]:
    """Swap chosen poses for better candidates until no swap raises the determinant (Fedorov 1972, one pose at a time)."""
    chosen = list(chosen)
    for _ in range(EXCHANGE_PASSES):
        swapped = False
        for k, old in enumerate(chosen):
            rest = [c for i, c in enumerate(chosen) if i != k]
            information = prior + np.einsum("cai,caj->ij", jacobians[rest], jacobians[rest])
            gains = _gains(jacobians, jacobians @ np.linalg.inv(information))
            gains[rest] = -np.inf
            best = int(np.argmax(gains))
            if best != old and gains[best] > gains[old] + SMALLEST_GAIN:
                chosen[k] = best
                swapped = True
        if not swapped:
            break
    return chosen


def log_determinant(jacobians: np.ndarray, prior: np.ndarray) -> float:
    """Return the log determinant of the information of poses (n_poses, n_axes, n_parameters) and the prior."""
    return float(np.linalg.slogdet(prior + np.einsum("cai,caj->ij", jacobians, jacobians))[1])


def _gains(jacobians: np.ndarray, gain_basis: np.ndarray) -> np.ndarray:
    """Log determinant gained by each candidate: log det(I + J C Jᵀ), gain_basis being J C."""
    blocks = np.einsum("cai,cbi->cab", gain_basis, jacobians)
    return np.linalg.slogdet(np.eye(blocks.shape[1]) + blocks)[1]


def _updated(gain_basis: np.ndarray, added: np.ndarray, basis_row: np.ndarray) -> np.ndarray:
    """J C after a pose came: C changes by rank n_axes (Woodbury)."""
    inner = np.linalg.inv(np.eye(len(added)) + basis_row @ added.T)
    return gain_basis - (gain_basis @ added.T) @ inner @ basis_row
