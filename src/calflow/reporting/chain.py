"""The sampled chain in the parameters' own units, thinned to what a figure can show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.reporting.material import Material
from calflow.sampling.chain_summary import ChainSummary
from calflow.sampling.posterior import Posterior, posterior_of

SHOWN_STEPS = 600


@dataclass(frozen=True)
class Chain:
    """Walkers in round coordinates, shape (n_ensembles, n_shown, n_walkers, n_dimensions), at these steps."""

    posterior: Posterior
    walkers: np.ndarray
    steps: np.ndarray
    discard: int

    @staticmethod
    def read(path: Path, material: Material) -> Chain:
        """Read the steps that the stage sample used, and rebuild the coordinates in which it sampled them."""
        import h5py

        posterior, _ = posterior_of(material.sampled[0], material.data)
        summary = material.results.document("sample/summary.json", ChainSummary)
        steps, discard = summary.steps, summary.burn_in_steps
        stride = -(-steps // SHOWN_STEPS)
        with h5py.File(path, "r") as file:
            names = sorted(file, key=lambda name: (len(name), name))
            walkers = np.array([file[name]["chain"][:steps:stride] for name in names])
        return Chain(posterior, walkers, np.arange(0, steps, stride), discard)

    def values(self, which: np.ndarray) -> np.ndarray:
        """Return these parameters [SI], the last one being the noise factor, shape (…, n_walkers, n_which)."""
        values = self.posterior.parameters(self.walkers)[..., which]
        return np.where(which == self.posterior.n_dimensions - 1, np.exp(values), values)

    def draws(self, which: np.ndarray, number: int) -> np.ndarray:
        """Return evenly spaced draws after the burn-in, shape (at most about number, n_which)."""
        kept = self.values(which)[:, self.steps >= self.discard].reshape(-1, len(which))
        return kept[:: max(1, len(kept) // number)]
