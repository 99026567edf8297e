"""Correlation: errors that rows share because they are near each other, in the covariance that tests go by.

What the model leaves is white noise and a background of random effects: V = s² (I + sum over parts of size² Z Zᵀ), each
part's Z smooth functions of one input. Multiplied by (V/s²)^-1/2, residuals and regressors are as independent as the tests
want them (generalised least squares: Aitken 1936).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROWS = 256  # that are whitened at once
SMALL = 0.02  # of a mode's variance over the noise's: less changes no test


@dataclass(frozen=True, eq=False)
class CorrelatedPart:
    """What one of a background's inputs does: its waves by modes (n_modes, n_waves), and its size's degrees of freedom."""

    waves: np.ndarray
    degrees_of_freedom: float


@dataclass(frozen=True, eq=False)
class ErrorCorrelation:
    """The modes (n, n_modes), orthonormal, of a background, their variance (n_modes,) over the noise's, and its parts.

    shared is the factor at which what the rows of a pose have in common counts (see `counted_once`).
    """

    modes: np.ndarray
    variance: np.ndarray
    parts: tuple[CorrelatedPart, ...]
    shared: float

    def whiten(self, values: np.ndarray) -> None:
        """Multiply values (n, …) by (V/s²)^-1/2 in their place: these are the largest arrays of all."""
        along = self.taken(self.modes.T @ values)
        for start in range(0, len(values), ROWS):
            part = slice(start, start + ROWS)
            values[part] -= self.modes[part] @ along

    def taken(self, along: np.ndarray) -> np.ndarray:
        """Return what is taken off along the modes of values that are (n_modes, …) along them."""
        return np.asarray(((1 - (1 + self.variance) ** -0.5) * along.T).T)

    def degrees_of_freedom(self, along: np.ndarray, visible: np.ndarray, of_noise: float) -> np.ndarray:
        """Return those of the variance of each column's amplitude, shape (n_columns,) (Satterthwaite 1946).

        What is uncertain because of a background whose size few waves tell is not as sure as the number of rows suggests.

        Args:
            along: whitened columns, freed of what the model imitates, along the modes, (n_modes, n_columns).
            visible: their squares summed, over modes and all else, (n_columns,).
            of_noise: degrees of freedom of the noise itself.
        """
        return self._satterthwaite(along / np.sqrt(1 + self.variance)[:, None], visible, of_noise)

    def sureness(self, weights: np.ndarray, of_noise: float) -> np.ndarray:
        """Return the degrees of freedom of the variance of weighted sums of residuals, weights (n, n_sums), shape (n_sums,)."""
        along = self.modes.T @ weights
        whole = (weights**2).sum(axis=0) + (self.variance[:, None] * along**2).sum(axis=0)
        return self._satterthwaite(along, whole, of_noise)

    def _satterthwaite(self, along: np.ndarray, whole: np.ndarray, of_noise: float) -> np.ndarray:
        """Degrees of freedom of variances (n_columns,), of which each part's share is by its waves along the modes."""
        whole = np.maximum(whole, np.finfo(float).tiny)
        left, unsure = np.ones(len(whole)), np.zeros(len(whole))
        for part in self.parts:
            share = ((part.waves.T @ along) ** 2).sum(axis=0) / whole
            left -= share
            unsure += share**2 / part.degrees_of_freedom
        return np.asarray(1 / (unsure + np.maximum(left, 0.0) ** 2 / of_noise))

    def covered(self, jacobian: np.ndarray) -> np.ndarray:
        """Return Jᵀ (V/s²) J of a Jacobian (n, n_parameters) that is not whitened by it."""
        along = self.modes.T @ jacobian
        return np.asarray(jacobian.T @ jacobian + along.T @ (self.variance[:, None] * along))


@dataclass(frozen=True, eq=False)
class Background:
    """What no cause explains: random smooth functions of inputs, over the noise, scaled by their size.

    modes (n, n_modes) are directions in which they act, parts hold each input's functions in these, (n_modes, n_waves). weight
    (n,) is what the rows' residuals were multiplied by when they were worked out, shared the factor of what rows of a pose have
    in common; degrees_of_freedom (n_parts,) are those of the sizes' estimates, gain is twice the logarithm of the likelihood that
    all parts together add; tried is how many parts there might have been.
    """

    inputs: tuple[tuple[str, ...], ...]
    modes: np.ndarray
    parts: tuple[np.ndarray, ...]
    weight: np.ndarray
    shared: float
    degrees_of_freedom: tuple[float, ...]
    gain: float
    tried: int

    def correlation(self, weight: np.ndarray) -> ErrorCorrelation:
        """Return the correlation of residuals that are multiplied by other weights (n,), of the same noise but for its level."""
        ratio = weight / self.weight
        basis, scaled = np.linalg.qr((ratio / np.median(ratio))[:, None] * self.modes)
        left, value, _ = np.linalg.svd(scaled @ np.hstack(self.parts), full_matrices=False)
        kept = value**2 > SMALL
        turned = left[:, kept].T @ scaled
        parts = tuple(
            CorrelatedPart(turned @ part, sure) for part, sure in zip(self.parts, self.degrees_of_freedom, strict=True)
        )
        return ErrorCorrelation(basis @ left[:, kept], value[kept] ** 2, parts, self.shared)
