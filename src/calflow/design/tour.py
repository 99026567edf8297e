"""The order in which poses are measured: a short tour of the joints, or one that time cannot be mistaken for a joint in."""

from __future__ import annotations

from typing import Literal

import numpy as np

Order = Literal["short", "random"]
BLOCK = 10  # poses of a block: each is drawn from all poses, and toured on the shortest way


def shortest_tour(readings: np.ndarray) -> np.ndarray:
    """Order poses for short travel: nearest neighbour, then 2-opt on the largest joint's motion; shape (n_poses,)."""
    distance = np.abs(readings[:, None] - readings[None]).max(axis=2).tolist()  # lists: single figures are asked for
    tour = [0]
    left = set(range(1, len(readings)))
    while left:
        last = distance[tour[-1]]
        tour.append(min(left, key=lambda j: last[j]))
        left.remove(tour[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 2):
            for j in range(i + 1, len(tour) - 1):
                before = distance[tour[i - 1]][tour[i]] + distance[tour[j]][tour[j + 1]]
                after = distance[tour[i - 1]][tour[j]] + distance[tour[i]][tour[j + 1]]
                if after < before - 1e-9:
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    improved = True
    return np.array(tour)


def random_blocks(readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Order poses in blocks drawn at random from all of them, each on a short tour; shape (n_poses,).

    What wanders in the course of the measurement then hangs together with no joint, and the ways stay bounded.
    """
    blocks = np.array_split(rng.permutation(len(readings)), max(1, round(len(readings) / BLOCK)))
    return np.concatenate([block[shortest_tour(readings[block])] for block in blocks])


def travel(readings: np.ndarray) -> float:
    """Return the way from pose to pose in this order: the largest joint's motion each time, summed [rad, or m]."""
    return float(np.abs(np.diff(readings, axis=0)).max(axis=1, initial=0.0).sum())
