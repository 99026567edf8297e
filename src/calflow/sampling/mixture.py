"""The mixture: predictions of all models that may be right, each as often as it is probable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.estimation.accuracy import errors
from calflow.measurements.measurements import Measurements
from calflow.sampling.sample import Sampled


@dataclass(frozen=True, eq=False)
class Mixture:
    """Draws of what may be predicted for some rows.

    errors (n_draws, n_rows, 3) [m] are predicted minus measured lengths, level (n_draws,) the factors on the noise, model
    (n_draws,) the number of the model, from 0, that a draw is of.
    """

    errors: np.ndarray
    level: np.ndarray
    model: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean of the errors, (n_rows, 3) [m]."""
        return np.asarray(self.errors.mean(axis=0))

    @property
    def covariance(self) -> np.ndarray:
        """Their covariance, (n_rows, 3, 3) [m²]: what is not known of the parameters, and which model is right."""
        off = self.errors - self.mean
        return np.asarray(np.einsum("dri,drj->rij", off, off) / max(len(off) - 1, 1))

    @property
    def of_choice(self) -> np.ndarray:
        """Share of the variance, over all axes, that is there because another model may be right, (n_rows,)."""
        off = self.errors - self.mean
        means = np.array([off[self.model == k].mean(axis=0) for k in self.model])
        between, whole = (np.nansum(part**2, axis=(0, 2)) for part in (means, off))
        return np.divide(between, whole, out=np.zeros_like(whole), where=whole > 0)


def mixture(sampled: Sampled, data: Measurements, number: int, rng: np.random.Generator) -> Mixture:
    """Draw a model, then its parameters, so many times, and predict the rows.

    Of what was found the chain's draws count, of the others those of their evidence. A cause that was held at its estimates gives
    way to its own rivals as often as these are right: its predictions are shifted as theirs are.
    """
    known, flat = sampled.known, sampled.values.reshape(-1, sampled.values.shape[-1])
    number = min(number, len(flat))
    models, probabilities = sampled.models.models, sampled.models.probabilities
    chosen = np.sort(rng.choice(len(models), size=number, p=probabilities)) if models else np.zeros(number, dtype=int)
    predicted, level = np.empty((number, len(data), 3)), np.empty(number)
    for k in np.unique(chosen):
        own = np.flatnonzero(chosen == k)
        model = models[k].model if k else known.model
        values = models[k].evidence.draws(len(own), rng) if k else flat[rng.choice(len(flat), len(own), replace=False)]
        predicted[own] = [errors(model, value[:-1], data) for value in values]
        level[own] = np.exp(values[:, -1])
    return Mixture(predicted + _shifts(sampled, data, number, rng), level, chosen)


def _shifts(sampled: Sampled, data: Measurements, number: int, rng: np.random.Generator) -> np.ndarray | float:
    """By how much the rivals of what was held shift the predictions, (n_draws, n_rows, 3) [m]; they do not exclude each other."""
    known = sampled.known
    if not known.alternatives:
        return 0.0
    here = errors(known.model, known.estimate, data)
    others = [replace(one.model, given=known.model.given) for one in known.alternatives]
    shifts = np.array(
        [errors(model, one.estimate, data) - here for model, one in zip(others, known.alternatives, strict=True)]
    )
    likely = [one.probability for one in known.alternatives]
    chosen = rng.random((number, len(shifts))) < likely
    return np.einsum("dk,kri->dri", chosen.astype(float), shifts)
