"""The noise of a position: from repeats, else from the file, else from what a fit leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import chi2

from calflow.measurements import Measurements

ESTIMATE_START = 1e-4  # m; only the weight of the data against the priors in the very first fit
SIGNIFICANT = 0.01  # p-value below which a lack of fit is believed
MIN_REPEATS = 10  # degrees of freedom below which repeats say too little


@dataclass(frozen=True)
class Noise:
    """The noise of each row's position and what the model leaves beyond it, per axis [m].

    sigma (n_rows,) is the device's, repeats (n_rows,) how many rows the row's pose and marker have. discrepancy is the
    model's own error: it is the same for all repeats of a pose, so measuring a pose again does not lessen it.
    """

    sigma: np.ndarray
    repeats: np.ndarray
    source: Literal["repeats", "file", "estimated"]
    discrepancy: float = 0.0

    @property
    def known(self) -> bool:
        """Whether it is known apart from the fit, so that a lack of fit can be told from noise."""
        return self.source != "estimated"

    @property
    def total(self) -> np.ndarray:
        """What to weigh each row by, shape (n_rows,): n repeats count together as one mean with its discrepancy."""
        return np.sqrt(self.sigma**2 + self.repeats * self.discrepancy**2)

    def only(self, mask: np.ndarray) -> Noise:
        """Return the noise of the rows where mask is true."""
        return replace(self, sigma=self.sigma[mask], repeats=self.repeats[mask])

    @property
    def words(self) -> str:
        """The noise in words."""
        level = f"{1e3 * np.sqrt(np.mean(self.sigma**2)):.3g} mm per axis"
        return {
            "repeats": f"{level}, from repeated measurements of one pose (train poses, pooled)",
            "file": f"{level}, as the measurement file states it",
            "estimated": f"{level}, estimated from what the fit leaves; without repeats or a stated sigma a lack of fit "
            "cannot be told from noise",
        }[self.source]


@dataclass(frozen=True)
class LackOfFit:
    """The means of repeated rows against the noise: chi² per degree of freedom, its p-value, and the discrepancy [m]."""

    reduced_chi2: float
    p: float
    discrepancy: float


def lack_of_fit(error: np.ndarray, data: Measurements, noise: Noise, determined: float) -> LackOfFit:
    """Compare a fit's errors (n_rows, 3) [m] with the noise; determined is the number of parameters the data fixed.

    The discrepancy is the value at which each pose's mean error has the variance discrepancy² + sigma² / repeats that
    its chi² asks for; zero where the noise explains the errors (p above 1 %).
    """
    keys = data.table[["pose", "marker"]]
    means = pd.DataFrame(error).groupby([keys["pose"], keys["marker"]], sort=False).transform("mean").to_numpy()
    freedom = max(1.0, 3 * keys.drop_duplicates().shape[0] - determined)

    def chi_squared(discrepancy: float) -> float:
        total = replace(noise, discrepancy=discrepancy).total
        return float(((means / total[:, None]) ** 2).sum())

    found = chi_squared(0.0)
    p = float(chi2.sf(found, freedom))
    if p > SIGNIFICANT or found <= freedom:
        return LackOfFit(found / freedom, p, 0.0)
    largest = 10 * float(np.abs(means).max())
    return LackOfFit(found / freedom, p, brentq(lambda value: chi_squared(value) - freedom, 0.0, largest))


def noise(measured: Measurements, source: Literal["auto", "repeats", "file", "estimated"] = "auto") -> Noise:
    """Return the noise by the best source there is, or by the one asked for.

    Repeats are pooled over training poses and markers: sigma² is the sum of squares about each pose's mean over its
    degrees of freedom.
    """
    repeats = measured.table.groupby(["pose", "marker"])["repeat"].transform("size").to_numpy(dtype=float)
    repeated, freedom = _pooled(measured)
    if source == "repeats" or (source == "auto" and freedom >= MIN_REPEATS):
        return Noise(np.full(len(measured), repeated), repeats, "repeats")
    if measured.sigma is not None and source in ("auto", "file"):
        return Noise(measured.sigma, repeats, "file")
    return Noise(np.full(len(measured), ESTIMATE_START), repeats, "estimated")


def _pooled(measured: Measurements) -> tuple[float, int]:
    table = measured.table[measured.train]
    groups = table.groupby(["pose", "marker"])[["x", "y", "z"]]
    about_mean = table[["x", "y", "z"]].to_numpy() - groups.transform("mean").to_numpy()
    freedom = 3 * (len(table) - groups.ngroups)
    return float(np.sqrt((about_mean**2).sum() / freedom)) if freedom else np.nan, freedom
