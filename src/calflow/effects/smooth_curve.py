"""Smooth curve: a Gaussian process (Matern 5/2) over an interval, written in sine waves with its spectrum as their priors."""

from __future__ import annotations

from dataclasses import dataclass
from math import gamma, pi, sqrt

import casadi as ca
import numpy as np

NEGLIGIBLE = 1e-3  # share of the largest prior standard deviation below which a wave is left out
MARGIN = 1.1  # times half the interval at which the waves are tied to zero
RMS = 1 / sqrt(2)  # of a wave of amplitude 1


@dataclass(frozen=True)
class Wave:
    """One wave of a curve of variance 1: its number from 1, its amplitude's prior standard deviation, and its value."""

    number: int
    sd: float
    value: ca.SX


def waves(variable: ca.SX, low: float, high: float, length: float, finest: float) -> list[Wave]:
    """Return the waves of a curve of a variable (1,) from low to high, the longest first.

    Neighbours are alike as far as length, and nothing is resolved below finest; all in the variable's unit. The amplitudes
    are independent, so that smoothness is a prior like any other (Solin and Saerkkae 2020). Beyond the ends, by a twentieth of the
    interval, the curve is zero: waves that went on would tell there the mirror image of what was measured inside.
    """
    middle, half = (high + low) / 2, MARGIN * (high - low) / 2
    number = np.arange(1, int(2 * half / finest) + 1)
    sd = np.sqrt(_spectrum(pi * number / (2 * half), length) / half)
    inside = ca.fmax(middle - half, ca.fmin(middle + half, variable))
    angle = pi * (inside - middle + half) / (2 * half)
    kept = sd > NEGLIGIBLE * sd[0]
    values = ca.vertsplit(
        ca.sin(ca.DM(number[kept].astype(float)) * angle)
    )  # at once: one by one takes twenty times as long
    return [Wave(int(k), float(s), value) for k, s, value in zip(number[kept], sd[kept], values, strict=True)]


def _spectrum(omega: np.ndarray, length: float) -> np.ndarray:
    """Spectral density of a Matern 5/2 process of variance 1 (Rasmussen and Williams 2006, equation 4.15)."""
    rate = 5 / length**2
    return np.asarray(2 * sqrt(pi) * gamma(3) / gamma(2.5) * rate**2.5 * (rate + omega**2) ** -3)
