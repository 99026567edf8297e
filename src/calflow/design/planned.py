"""A planned measurement: how a further pose will be observed, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.estimation.noise import Noise
from calflow.model import Model
from calflow.observations import Observation


@dataclass(frozen=True)
class Planned:
    """One kind of observation with its standard deviations: sigma of lengths [m], and rotation of orientations [rad]."""

    observation: Observation
    sigma: float
    rotation: float = float("nan")

    @staticmethod
    def like(observation: Observation, noise: Noise, k: int, share: float = 1.0) -> Planned:
        """Return what the rows of a series (the k-th) were, where only a share of the further ones is fitted."""
        own = noise.of_series(k)
        rotation = noise.total_rotation
        return Planned(
            observation, float(np.sqrt(np.mean(noise.total[own] ** 2) / share)),
            float("nan") if rotation is None else float(np.sqrt(np.mean(rotation[own] ** 2) / share)),
        )  # fmt: skip

    def whitened(self, model: Model, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the whitened Jacobian (n_rows, n_units, n_parameters) of packed conditions (n_conditions, n_rows) at p.

        The model's observations hold the planned one.
        """
        reported = self.observation.expected(model.point(p, rows), model.rotation(p, rows))
        jacobian = model.observed_jacobian(self.observation, p, rows, reported)
        sd = np.array([self.rotation if unit == "rad" else self.sigma for unit in self.observation.units])
        return jacobian / sd[:, None]
