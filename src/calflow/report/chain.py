"""The sampled chain in the parameters' own units, thinned to what a figure can show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.report.material import Material
from calflow.stages.fit import Problem
from calflow.stages.posterior import Laplace, Posterior

SHOWN_STEPS = 600
BURN_IN = 5  # autocorrelation times that are left out, a quarter of the chain at most: as the stage sample does


@dataclass(frozen=True)
class Chain:
    """Walkers in scaled coordinates, shape (n_ensembles, n_shown, n_walkers, n_dimensions), at these steps."""

    posterior: Posterior
    walkers: np.ndarray
    steps: np.ndarray
    discard: int

    @staticmethod
    def read(path: Path, material: Material, autocorrelation: float) -> Chain:
        """Read the chain and rebuild the coordinates in which it was sampled."""
        import h5py

        known, data = material.known, material.data
        train = data.only(data.train)
        problem = Problem.of(known.model, train, known.noise(data).only(data.train))
        posterior = Posterior.about(problem, Laplace.of(problem, known.estimate, known.at_bound))
        with h5py.File(path, "r") as file:
            groups = [file[name] for name in sorted(file, key=lambda name: (len(name), name))]
            steps = min(int(group.attrs["iteration"]) for group in groups)
            stride = -(-steps // SHOWN_STEPS)
            walkers = np.array([group["chain"][:steps:stride] for group in groups])
        discard = min(steps // 4, int(np.ceil(BURN_IN * autocorrelation)))
        return Chain(posterior, walkers, np.arange(0, steps, stride), discard)

    def values(self, which: np.ndarray) -> np.ndarray:
        """Return these parameters [SI], the last one being the noise factor, shape (…, n_walkers, n_which)."""
        values = self.posterior.centre[which] + self.walkers @ self.posterior.factor[which].T
        return np.where(which == self.posterior.n_dimensions - 1, np.exp(values), values)

    def draws(self, which: np.ndarray, number: int) -> np.ndarray:
        """Return evenly spaced draws after the burn-in, shape (at most about number, n_which)."""
        kept = self.values(which)[:, self.steps >= self.discard].reshape(-1, len(which))
        return kept[:: max(1, len(kept) // number)]
