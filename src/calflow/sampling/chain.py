"""The Markov chain: its required length, and its file in the format of emcee's HDF backend, written atomically."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from calflow.files.toml import FileModel
from calflow.files.writing import write_whole

if TYPE_CHECKING:
    import h5py
    from emcee.backends import Backend

ENOUGH_TAU = 30  # least length of a chain in units of the longest autocorrelation time, estimated from all walkers
BLOBS = np.dtype([("log_prior", np.float64), ("log_likelihood", np.float64)])  # of each draw
SAVED = ("chain", "log_prob", "blobs", "accepted")  # of an ensemble, under the names of emcee's HDF backend
DIGEST = 512  # bytes of HDF5's user block, which holds the SHA-256 of the rest; a run continues no other file


class ChainLength(FileModel):
    """The required length of a chain, and its mixture of moves.

    Each of the ensembles has this number of walkers (None: twice the dimensions). They are extended by block steps until every
    parameter has ess effective samples, or to max_steps. independent is the share of the independence proposal.
    """

    ensembles: Annotated[int, Field(ge=4)] = 4
    walkers: Annotated[int, Field(ge=4)] | None = None
    block: Annotated[int, Field(ge=10)] = 20
    max_steps: Annotated[int, Field(ge=50)] = 2000
    ess: Annotated[int, Field(ge=100)] = 4000
    independent: Annotated[float, Field(ge=0, le=1)] = 0.9

    def share(self, steps: int, tau: float, ess: float) -> float:
        """Return the share of the required length that steps of an autocorrelation time have, with their effective samples."""
        return min(1.0, steps / (ENOUGH_TAU * tau), ess / self.ess)


@dataclass(frozen=True)
class Chain:
    """Independent ensembles of walkers in memory, their file, and the share of independence proposals among their moves.

    The file is replaced atomically (see `write_whole`): HDF5 writes tables and index piecemeal, so that a write interrupted
    between the two, or by a full disk, would leave a file that cannot be opened.
    """

    path: Path
    ensembles: tuple[Backend, ...]
    independent: float

    @staticmethod
    def open(path: Path, number: int, shape: tuple[int, int], independent: float, say: Callable[[str], None]) -> Chain:
        """Return a chain of ensembles (n_walkers, n_dimensions), continued from its file unless damaged or of another kind."""
        if path.exists():
            try:
                chain = Chain.read(path)
                if chain.independent == independent and [kept.shape for kept in chain.ensembles] == number * [shape]:
                    say(f"resuming after {min(kept.iteration for kept in chain.ensembles)} steps")
                    return chain
            except (OSError, ValueError) as error:
                say(f"chain.h5 cannot be read ({error}): sampling starts anew")
        return Chain(path, tuple(_ensemble(*shape) for _ in range(number)), independent)

    @staticmethod
    def read(path: Path) -> Chain:
        """Return the chain in a file; raises OSError if it cannot be read, ValueError if it was changed since it was written."""
        import h5py

        content = path.read_bytes()
        if content[:DIGEST] != _digest(content[DIGEST:]):
            raise ValueError("its checksum is wrong")
        with h5py.File(io.BytesIO(content), "r") as file:
            ensembles = tuple(_loaded(file[f"ensemble{number}"]) for number in range(1, len(file) + 1))
            return Chain(path, ensembles, float(file.attrs["independent"]))

    def save(self) -> None:
        """Write all steps so far to the file; raises OSError where the disk is full."""
        import h5py

        image = io.BytesIO()
        with h5py.File(image, "w", userblock_size=DIGEST) as file:
            file.attrs["independent"] = self.independent
            for number, ensemble in enumerate(self.ensembles, start=1):
                _store(ensemble, file.create_group(f"ensemble{number}"))
        content = image.getbuffer()[DIGEST:]
        write_whole(self.path, _digest(content) + content)

    def walkers(self, discard: int, steps: int) -> np.ndarray:
        """Return the walkers of steps discard to steps, shape (n_ensembles, n_steps, n_walkers, n_dimensions)."""
        return np.array([ensemble.get_chain()[discard:steps] for ensemble in self.ensembles])

    def densities(self, discard: int, steps: int) -> np.ndarray:
        """Return their log prior and log likelihood, a structured array (n_ensembles, n_steps, n_walkers) of type BLOBS."""
        return np.array([ensemble.get_blobs()[discard:steps] for ensemble in self.ensembles])


def _store(ensemble: Backend, group: h5py.Group) -> None:
    """Write an ensemble at once, in the layout that emcee's HDF backend writes step by step."""
    import emcee

    n_walkers, n_dimensions = ensemble.shape
    group.attrs.update(
        version=emcee.__version__, nwalkers=n_walkers, ndim=n_dimensions, has_blobs=True, iteration=ensemble.iteration,
        **{f"random_state_{number}": value for number, value in enumerate(ensemble.random_state)},
    )  # fmt: skip
    for name in SAVED:
        values = getattr(ensemble, name)
        group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]))  # emcee may go on from it


def _ensemble(n_walkers: int, n_dimensions: int) -> Backend:
    """Return an ensemble in memory before its first step."""
    from emcee.backends import Backend

    ensemble = Backend()
    ensemble.reset(n_walkers, n_dimensions)
    return ensemble


def _loaded(group: h5py.Group) -> Backend:
    """Return an ensemble of a file as a backend in memory."""
    ensemble = _ensemble(group.attrs["nwalkers"], group.attrs["ndim"])
    ensemble.iteration = int(group.attrs["iteration"])
    ensemble.random_state = [group.attrs[name] for name in sorted(group.attrs) if name.startswith("random_state_")]
    for name in SAVED:
        setattr(ensemble, name, group[name][:])
    return ensemble


def _digest(content: bytes | memoryview) -> bytes:
    return hashlib.sha256(content).hexdigest().encode().ljust(DIGEST, b"\0")
