"""The chain on disk: emcee's HDF backend, written a block of steps at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np


class BlockBackend(emcee.backends.HDFBackend):
    """emcee's HDF format, but whole blocks are appended: one write a block instead of one a step."""

    def append(self, block: emcee.backends.Backend, random_state: tuple[Any, ...]) -> None:
        """Append an in-memory backend's steps and the random state that follows them."""
        chain, log_probability = block.get_chain(), block.get_log_prob()
        self.grow(len(chain), None)
        with self.open("a") as file:
            group = file[self.name]
            done = group.attrs["iteration"]
            group["chain"][done : done + len(chain)] = chain
            group["log_prob"][done : done + len(chain)] = log_probability
            group["accepted"][:] += block.accepted.astype(group["accepted"].dtype)
            for i, value in enumerate(random_state):
                group.attrs[f"random_state_{i}"] = value
            group.attrs["iteration"] = done + len(chain)


def open_ensembles(
    path: Path, number: int, shape: tuple[int, int], independent: float, say: Callable[[str], None]
) -> list[BlockBackend]:
    """Open the chain file's ensembles of shape (n_walkers, n_dimensions), to go on where they end.

    A file that cannot be read, or that was sampled otherwise (independent is the share of independent moves), starts anew.
    """
    backends = [BlockBackend(str(path), name=f"ensemble{i + 1}") for i in range(number)]
    try:
        if path.exists() and _sampled_alike(path, backends, shape, independent):
            say(f"resuming after {min(backend.iteration for backend in backends)} steps")
            return backends
    except (OSError, KeyError, RuntimeError, ValueError) as error:  # h5py has no error of its own
        say(f"chain.h5 cannot be read ({error}): sampling starts anew")
    path.unlink(missing_ok=True)
    for backend in backends:
        backend.reset(*shape)
    with h5py.File(path, "a") as file:
        file.attrs["independent"] = independent
    return backends


def _sampled_alike(path: Path, backends: list[BlockBackend], shape: tuple[int, int], independent: float) -> bool:
    with h5py.File(path) as file:
        if file.attrs["independent"] != independent or len(file) != len(backends):
            return False
    return all(backend.initialized and backend.shape == shape for backend in backends)


def joined(backends: list[BlockBackend], discard: int, steps: int) -> np.ndarray:
    """Return the steps from discard to steps, shape (n_ensembles, n_steps, n_walkers, n_dimensions)."""
    return np.array([backend.get_chain()[discard:steps] for backend in backends])
