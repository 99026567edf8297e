"""The noise of a position: from repeats, else from the file, else from what a fit leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calflow.measurements import Measurements

ESTIMATE_START = 1e-4  # m; only the weight of the data against the priors in the very first fit
ROTATION = ("rx", "ry", "rz", "qw", "qx", "qy", "qz", "sigma_rotation")
SIGNIFICANT = 0.01  # p-value below which a lack of fit is believed
MIN_REPEATS = 10  # degrees of freedom below which repeats say too little


@dataclass(frozen=True)
class Noise:
    """The noise of each row's position and what the model leaves beyond it, per axis [m].

    sigma (n_rows,) is the device's. discrepancy is the model's own error, alike in all rows.
    """

    sigma: np.ndarray
    source: Literal["repeats", "file", "estimated"]
    discrepancy: float = 0.0

    @property
    def known(self) -> bool:
        """Whether it is known apart from the fit, so that a lack of fit can be told from noise."""
        return self.source != "estimated"

    @property
    def total(self) -> np.ndarray:
        """Standard deviation of each row about the model, shape (n_rows,)."""
        return np.hypot(self.sigma, self.discrepancy)

    def only(self, mask: np.ndarray) -> Noise:
        """Return the noise of the rows where mask is true."""
        return replace(self, sigma=self.sigma[mask])

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


def averaged(data: Measurements, level: Noise) -> tuple[Measurements, Noise]:
    """Return the mean of each pose's repeats under equal conditions, and the noise of the means.

    The model's discrepancy is the same in all repeats of a pose, so that together they are one piece of evidence. A
    noise that is not known has no repeats to speak of, and rows stay as they are.
    """
    measured = [name for name in ("x", "y", "z", *ROTATION, "sigma", "repeat", "line") if name in data.table]
    keys = [name for name in data.table.columns if name not in measured]
    group = data.table.groupby(keys, sort=False, dropna=False).ngroup().to_numpy()
    count = np.bincount(group)
    if not level.known or (count == 1).all():
        return data, level
    first = np.unique(group, return_index=True)[1]
    table = data.table.iloc[first].reset_index(drop=True)
    for axis in ("x", "y", "z"):
        table[axis] = np.bincount(group, weights=data.table[axis]) / count
    if data.rotation is not None:
        turns = [Rotation.from_matrix(data.rotation[group == k]).mean() for k in range(len(count))]
        table = table.drop(columns=[name for name in ROTATION if name in table])
        table[["rx", "ry", "rz"]] = Rotation.concatenate(turns).as_euler("XYZ")
    sigma = np.sqrt(np.bincount(group, weights=level.sigma**2)) / count
    return replace(data, table=table), replace(level, sigma=sigma)


@dataclass(frozen=True)
class LackOfFit:
    """A fit's errors against the noise: chi² per degree of freedom, its p-value, and the discrepancy [m]."""

    reduced_chi2: float
    p: float
    discrepancy: float


def lack_of_fit(error: np.ndarray, level: Noise, determined: float) -> LackOfFit:
    """Compare a fit's errors (n_rows, 3) [m] with the noise; determined is the number of parameters the data fixed.

    The discrepancy is what has to be added to the noise for chi² to equal its degrees of freedom; zero where the noise
    explains the errors (p above 1 %).
    """
    freedom = max(1.0, error.size - determined)

    def chi_squared(discrepancy: float) -> float:
        return float(((error / replace(level, discrepancy=discrepancy).total[:, None]) ** 2).sum())

    found = chi_squared(0.0)
    p = float(chi2.sf(found, freedom))
    if p > SIGNIFICANT or found <= freedom:
        return LackOfFit(found / freedom, p, 0.0)
    largest = 10 * float(np.abs(error).max())
    return LackOfFit(found / freedom, p, brentq(lambda value: chi_squared(value) - freedom, 0.0, largest))


def noise(measured: Measurements, source: Literal["auto", "repeats", "file", "estimated"] = "auto") -> Noise:
    """Return the noise by the best source there is, or by the one asked for.

    Repeats are pooled over training poses and markers: sigma² is the sum of squares about each pose's mean over its
    degrees of freedom.
    """
    repeated, freedom = _pooled(measured)
    if source == "repeats" or (source == "auto" and freedom >= MIN_REPEATS):
        return Noise(np.full(len(measured), repeated), "repeats")
    if measured.sigma is not None and source in ("auto", "file"):
        return Noise(measured.sigma, "file")
    return Noise(np.full(len(measured), ESTIMATE_START), "estimated")


def _pooled(measured: Measurements) -> tuple[float, int]:
    table = measured.table[measured.train]
    groups = table.groupby(["pose", "marker"])[["x", "y", "z"]]
    about_mean = table[["x", "y", "z"]].to_numpy() - groups.transform("mean").to_numpy()
    freedom = 3 * (len(table) - groups.ngroups)
    return float(np.sqrt((about_mean**2).sum() / freedom)) if freedom else np.nan, freedom
