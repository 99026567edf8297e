"""The chain on disk: emcee's HDF backend, written a block of steps at a time and sealed with a checksum."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np

PADDED = 2  # times its content that a chunked table takes at most, nearly
OVERHEAD = 1 << 16  # bytes of a block that are not its steps
KEPT = np.dtype([("log_prior", np.float64), ("log_likelihood", np.float64)])  # of each draw: emcee's blobs
COORDINATES = "cut normals"  # in which walkers are kept; a chain in others is not gone on from
STEPS, SEAL = "steps_sha256", "seal_sha256"  # attributes of an ensemble's group


class BlockBackend(emcee.backends.HDFBackend):
    """emcee's HDF format, but whole blocks are appended: one write a block instead of one a step.

    Its blobs are each draw's log prior and log likelihood.
    Each group has the SHA-256 of its steps, each hashed with what came before, and a seal over that and the state to go on
    from: a chain in which a bit was turned is not sampled on.
    """

    def reset(self, nwalkers: int, ndim: int) -> None:
        """Begin an empty ensemble, with its blobs, for which room is asked before the first block."""
        super().reset(nwalkers, ndim)
        with self.open("a") as file:
            group = file[self.name]
            group.create_dataset("blobs", (0, nwalkers), maxshape=(None, nwalkers), dtype=KEPT)
            group.attrs["has_blobs"] = True

    def append(self, block: emcee.backends.Backend, random_state: tuple[Any, ...]) -> None:
        """Append an in-memory backend's steps and the random state that follows them.

        It is done in a copy of the file that then takes its place: HDF5 writes its tables and what it knows of them piece by piece,
        and a file in which it was stopped between two of them cannot be opened.

        Raises:
            OSError: there is no room on the disk.
        """
        path = Path(self.filename)
        part = _beside(path)
        try:
            shutil.copyfile(path, part)
            BlockBackend(str(part), name=self.name)._append(block, random_state)
            os.replace(part, path)
        except OSError:
            part.unlink(missing_ok=True)
            raise

    def _append(self, block: emcee.backends.Backend, random_state: tuple[Any, ...]) -> None:
        chain, log_probability, kept = block.get_chain(), block.get_log_prob(), block.get_blobs()
        done, accepted = self.iteration, self.accepted + block.accepted
        steps = _hashed(self._steps if done else "", chain, log_probability, kept)
        self._reserve(len(chain))
        self.grow(len(chain), kept[0])
        with self.open("a") as file:
            group = file[self.name]
            group["chain"][done : done + len(chain)] = chain
            group["log_prob"][done : done + len(chain)] = log_probability
            group["blobs"][done : done + len(chain)] = kept
            group["accepted"][:] = accepted
            for i, value in enumerate(random_state):
                group.attrs[f"random_state_{i}"] = value
            group.attrs[STEPS], group.attrs[SEAL] = steps, _sealed(steps, accepted, random_state)
            group.attrs["iteration"] = done + len(chain)

    def _reserve(self, n_steps: int) -> None:
        """Ask for room on the disk for more steps, before HDF5 does, which crashes where there is none.

        Raises:
            OSError: there is no room.
        """
        with self.open() as file:
            tables = [file[self.name][name] for name in ("chain", "log_prob", "blobs")]
            needed = [(n_steps + table.chunks[0]) * np.prod(table.shape[1:]) * table.dtype.itemsize for table in tables]
        if hasattr(os, "posix_fallocate"):
            path = Path(self.filename)
            with path.open("r+b") as raw:
                os.posix_fallocate(raw.fileno(), path.stat().st_size, PADDED * int(sum(needed)) + OVERHEAD)

    @property
    def _steps(self) -> str:
        """The hash of the steps so far."""
        with self.open() as file:
            return str(file[self.name].attrs[STEPS])

    @property
    def whole(self) -> bool:
        """Whether what is read is what was written."""
        if not self.iteration:
            return True
        with self.open() as file:
            seal = file[self.name].attrs[SEAL]
        steps = _hashed("", self.get_chain(), self.get_log_prob(), self.get_blobs())
        return bool(seal == _sealed(steps, self.accepted, self.random_state))


def open_ensembles(
    path: Path, number: int, shape: tuple[int, int], independent: float, say: Callable[[str], None]
) -> list[BlockBackend]:
    """Open the chain file's ensembles of shape (n_walkers, n_dimensions), to go on where they end.

    A file that cannot be read, that lacks what is kept of each draw, or that was sampled otherwise (independent is the share
    of independent moves), starts anew.
    """
    _beside(path).unlink(missing_ok=True)  # of a program that was killed while it wrote
    backends = [BlockBackend(str(path), name=f"ensemble{i + 1}") for i in range(number)]
    try:
        if path.exists() and _sampled_alike(path, backends, shape, independent):
            if not all(backend.has_blobs() for backend in backends):
                raise ValueError(
                    "it does not keep each draw's log prior and log likelihood, being of an earlier version"
                )
            if not all(backend.whole for backend in backends):
                raise ValueError("its checksum is wrong")
            say(f"resuming after {min(backend.iteration for backend in backends)} steps")
            return backends
    except Exception as error:  # h5py has no error of its own: what it raises depends on the bit that is wrong
        say(f"chain.h5 cannot be read ({error}): sampling starts anew")
    path.unlink(missing_ok=True)
    for backend in backends:
        backend.reset(*shape)
    with h5py.File(path, "a") as file:
        file.attrs["independent"], file.attrs["coordinates"] = independent, COORDINATES
    return backends


def _beside(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def _sampled_alike(path: Path, backends: list[BlockBackend], shape: tuple[int, int], independent: float) -> bool:
    with h5py.File(path) as file:
        if file.attrs["independent"] != independent or len(file) != len(backends):
            return False
        if file.attrs.get("coordinates") != COORDINATES:
            raise ValueError("its walkers are in the coordinates of an earlier version")
    return all(backend.initialized and backend.shape == shape for backend in backends)


def _hashed(before: str, *tables: np.ndarray) -> str:
    """Return the hash of all steps, from that of those before; how they were parted into blocks makes no difference."""
    for step in zip(*tables, strict=True):
        before = hashlib.sha256(before.encode() + b"".join(part.tobytes() for part in step)).hexdigest()
    return before


def _sealed(steps: str, accepted: np.ndarray, random_state: Iterable[Any]) -> str:
    """Return the hash of the steps' hash, what was accepted and the random state."""
    seal = hashlib.sha256(steps.encode() + accepted.astype(np.int64).tobytes())
    for value in random_state:
        seal.update(value.tobytes() if isinstance(value, np.ndarray) else str(value).encode())
    return seal.hexdigest()


def joined(backends: list[BlockBackend], discard: int, steps: int) -> np.ndarray:
    """Return the steps from discard to steps, shape (n_ensembles, n_steps, n_walkers, n_dimensions)."""
    return np.array([backend.get_chain()[discard:steps] for backend in backends])


def joined_kept(backends: list[BlockBackend], discard: int, steps: int) -> np.ndarray:
    """Return what was kept of the same draws, a structured array (n_ensembles, n_steps, n_walkers) of type KEPT."""
    return np.array([backend.get_blobs()[discard:steps] for backend in backends])
