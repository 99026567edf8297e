"""A smooth curve of one variable: a Matern 5/2 process on an interval, expanded in sine waves (`waves`)."""

from __future__ import annotations

from dataclasses import dataclass
from math import gamma, pi, sqrt

import casadi as ca
import numpy as np

from calflow.measurements.measurements import Measurements

NEGLIGIBLE = 1e-3  # share of the largest prior standard deviation below which a basis function is dropped
MARGIN = 1.1  # half-width of the domain, whose ends have zero boundary values, over that of the interval
RMS = 1 / sqrt(2)  # root mean square of a sine wave of amplitude 1


@dataclass(frozen=True, eq=False)
class Travel:
    """The ends of a smooth curve's travel, its correlation length [rad], and the mean products (n, n) of its basis functions."""

    low: float
    high: float
    length: float
    products: np.ndarray


def different_positions(data: Measurements) -> np.ndarray:
    """Return the number of different positions of each joint in the data, shape (n_joints,)."""
    return np.array([len(np.unique(np.round(column, 4))) for column in data.joint_angles.T])


def travel_ends(data: Measurements, dense: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the lower and upper ends of the joints' travels in the data [rad, or m], 0 for joints not covered densely."""
    q = data.joint_angles
    low, high = (tuple(map(float, np.where(dense, side, 0.0))) for side in (q.min(axis=0), q.max(axis=0)))
    return low, high


@dataclass(frozen=True)
class Wave:
    """A sine basis function of a unit-variance process: number (from 1), amplitude's prior sd, value, mean over interval."""

    number: int
    sd: float
    value: ca.SX
    mean: float


def waves(variable: ca.SX, low: float, high: float, length: float, finest: float) -> list[Wave]:
    """Return the sine basis functions of a smooth curve of a variable (1,) on [low, high], longest wavelength first.

    length is the correlation length and finest the resolution, both in the variable's unit. The amplitudes are independent
    a priori, their variance the spectral density (Solin and Saerkkae 2020), so that smoothness is an ordinary prior. Beyond
    the ends, by a twentieth of the interval, the curve is zero: continued waves would mirror what was measured inside.
    """
    middle, half = (high + low) / 2, MARGIN * (high - low) / 2
    number = np.arange(1, int(2 * half / finest) + 1)
    sd = np.sqrt(_spectrum(pi * number / (2 * half), length) / half)
    inside = ca.fmax(middle - half, ca.fmin(middle + half, variable))
    angle = pi * (inside - middle + half) / (2 * half)
    kept = sd > NEGLIGIBLE * sd[0]
    # One vectorised sine: building the waves separately takes twenty times as long.
    values = ca.vertsplit(ca.sin(ca.DM(number[kept].astype(float)) * angle))
    begin, end = (pi * number[kept] * (0.5 + side * (high - low) / (4 * half)) for side in (-1, 1))
    mean = (np.cos(begin) - np.cos(end)) / (end - begin)
    every = zip(number[kept], sd[kept], values, mean, strict=True)
    return [Wave(int(k), float(s), value, float(m)) for k, s, value, m in every]


def _spectrum(omega: np.ndarray, length: float) -> np.ndarray:
    """Return the spectral density of a unit-variance Matern 5/2 process (Rasmussen and Williams 2006, equation 4.15)."""
    rate = 5 / length**2
    return np.asarray(2 * sqrt(pi) * gamma(3) / gamma(2.5) * rate**2.5 * (rate + omega**2) ** -3)
