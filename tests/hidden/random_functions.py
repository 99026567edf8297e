"""What is drawn at random: directions, smooth functions of a few inputs, and walks in time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray
WAVES = 200


def direction(rng: np.random.Generator) -> Array:
    """A random unit vector."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_function(rng: np.random.Generator, inputs: int, outputs: int, length: float) -> Callable[[Array], Array]:
    """A smooth random function of rms about one (points, inputs) -> (points, outputs), a sum of waves."""
    waves = rng.normal(0, 1 / length, (outputs, inputs, WAVES))
    phases = rng.uniform(0, 2 * np.pi, (outputs, 1, WAVES))
    return lambda x: np.cos(x @ waves + phases).sum(axis=-1).T / np.sqrt(WAVES / 2)


def random_walk(rng: np.random.Generator, time: Array, outputs: int, memory: float) -> Array:
    """An Ornstein-Uhlenbeck process of rms one at these times (rows,) [s], shape (rows, outputs): it forgets over memory [s]."""
    order = np.argsort(time, kind="stable")
    kept = np.exp(-np.diff(time[order]) / memory)
    walk = np.empty((len(time), outputs))
    walk[order[0]] = rng.standard_normal(outputs)
    for before, after, share in zip(order[:-1], order[1:], kept, strict=True):
        walk[after] = share * walk[before] + np.sqrt(1 - share**2) * rng.standard_normal(outputs)
    return walk
