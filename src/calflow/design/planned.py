"""A planned measurement: how a further pose will be observed, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.estimation.least_squares import LeastSquares, SeriesBlock
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
        return jacobian / self._sd[:, None]

    def problem(self, model: Model, p: np.ndarray, rows: np.ndarray) -> LeastSquares:
        """Return the least squares problem of packed conditions (n_conditions, n_rows) that report what the model says at p.

        The planned observation is the model's only one.
        """
        reported = self.observation.expected(model.point(p, rows), model.rotation(p, rows))
        sigma = np.tile(self._sd[:, None], rows.shape[1])
        own = np.arange(rows.shape[1])
        return LeastSquares(
            model, (SeriesBlock(model, self.observation, own, rows, reported, 1 / sigma, sigma, sigma),)
        )

    @property
    def _sd(self) -> np.ndarray:
        """Standard deviation of each unit reported."""
        return np.array([self.rotation if unit == "rad" else self.sigma for unit in self.observation.units])
