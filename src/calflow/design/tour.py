"""The order in which poses are measured: a short tour of the joints."""

from __future__ import annotations

import numpy as np


def shortest_tour(readings: np.ndarray) -> np.ndarray:
    """Order poses for short travel: nearest neighbour, then 2-opt on the largest joint's motion; shape (n_poses,)."""
    distance = np.abs(readings[:, None] - readings[None]).max(axis=2)
    tour = [0]
    left = set(range(1, len(readings)))
    while left:
        tour.append(min(left, key=lambda j: distance[tour[-1], j]))
        left.remove(tour[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 2):
            for j in range(i + 1, len(tour) - 1):
                before = distance[tour[i - 1], tour[i]] + distance[tour[j], tour[j + 1]]
                after = distance[tour[i - 1], tour[j]] + distance[tour[i], tour[j + 1]]
                if after < before - 1e-9:
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    improved = True
    return np.array(tour)
