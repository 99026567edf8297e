"""The noise of a measurement, and what the model leaves beyond it: its discrepancy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.model import build

ESTIMATE_START = 1e-4  # m; only the weight of the data against the priors in the very first fit
SIGNIFICANT = 0.01  # p-value below which a lack of fit is believed
MIN_REPEATS = 10  # degrees of freedom below which repeats say too little
LEAST_SCATTER = 1e-7  # m; repeats that scatter less are one reading written twice, and no robot leaves less
BROKEN = 3.0  # times the median by which the mean square may exceed it: else a few rows are wrong, not the device bad
GROSS = 4.0  # robust standard deviations from which a robust fit takes an error for an outlier
NORMAL_MEDIAN = 0.6745  # median of |x| of a standard normal

Source = Literal["repeats", "file", "estimated"]


@dataclass(frozen=True)
class Noise:
    """The device's noise of each row, per axis, and the model's discrepancy, alike in all rows.

    sigma (n_rows,) and discrepancy are of positions [m]; rotation (n_rows,) and rotation_discrepancy of orientations
    [rad], where they were measured.
    """

    sigma: np.ndarray
    source: Source
    discrepancy: float = 0.0
    rotation: np.ndarray | None = None
    rotation_discrepancy: float = 0.0

    @property
    def known(self) -> bool:
        """Whether it is known apart from the fit, so that a lack of fit can be told from noise."""
        return self.source != "estimated"

    @property
    def total(self) -> np.ndarray:
        """Standard deviation of each row about the model, shape (1, n_rows), or (2, n_rows) with orientations."""
        position = np.hypot(self.sigma, self.discrepancy)
        if self.rotation is None:
            return position[None]
        return np.vstack([position, np.hypot(self.rotation, self.rotation_discrepancy)])

    def only(self, mask: np.ndarray) -> Noise:
        """Return the noise of the rows where mask is true."""
        return replace(self, sigma=self.sigma[mask], rotation=None if self.rotation is None else self.rotation[mask])

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
    """Errors of one kind against their noise: chi² per degree of degrees_of_freedom, its p-value, and the discrepancy."""

    reduced_chi2: float
    p: float
    discrepancy: float


def noise(data: Measurements, source: Literal["auto", "repeats", "file", "estimated"] = "auto") -> Noise:
    """Return the noise by the best source there is, or by the one asked for.

    Repeats are pooled over training poses: sigma² is the sum of squares about each pose's mean over its degrees of
    degrees_of_freedom, after the nominal robot's part is taken off, so that repeats need not stand at the very same readings. Where
    a few gross errors make most of it, the median of the scatter stands for it, and those rows are flagged.

    Raises:
        InputError: the source asked for is not in the data.
    """
    rotation = data.table["sigma_rotation"].to_numpy() if data.rotation is not None else None
    pooled, degrees_of_freedom = _pooled(data)
    if source == "repeats" and not pooled > LEAST_SCATTER:
        raise refuse('noise = "repeats" needs poses that were measured several times', key="stages.identify.noise")
    if source == "file" and data.sigma is None:
        raise refuse('noise = "file" needs a column sigma_mm, or sigma_mm in the study', key="stages.identify.noise")
    if source == "repeats" or (source == "auto" and degrees_of_freedom >= MIN_REPEATS and pooled > LEAST_SCATTER):
        return Noise(np.full(len(data), pooled), "repeats", rotation=rotation)
    if data.sigma is not None and source in ("auto", "file"):
        return Noise(data.sigma, "file", rotation=rotation)
    return Noise(np.full(len(data), ESTIMATE_START), "estimated", rotation=rotation)


def averaged(data: Measurements, level: Noise) -> tuple[Measurements, Noise]:
    """Return the mean of each pose's repeats (see `conditions`), and the noise of the means.

    The model's discrepancy is the same in all repeats of a pose, so that together they are one piece of evidence.
    """
    group = conditions(data)
    count = np.bincount(group)
    if (count == 1).all():
        return data, level
    first = np.unique(group, return_index=True)[1]
    table = data.table.iloc[first].reset_index(drop=True)
    table["of_repeats"] = count
    for name in data.table.columns:
        if name not in ("pose", "repeat", "line") and data.table[name].dtype.kind == "f":
            table[name] = np.bincount(group, weights=data.table[name]) / count

    def of_means(sigma: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(np.bincount(group, weights=sigma**2)) / count)

    rotation = None
    if data.rotation is not None and level.rotation is not None:
        turns = Rotation.from_matrix(data.rotation)
        means = Rotation.concatenate([turns[np.flatnonzero(group == k)].mean() for k in range(len(count))])
        table = table.drop(columns=["qw", "qx", "qy", "qz"], errors="ignore")
        table[["rx", "ry", "rz"]] = means.as_euler("XYZ")
        rotation = of_means(level.rotation)
        table["sigma_rotation"] = rotation
    return replace(data, table=table), replace(level, sigma=of_means(level.sigma), rotation=rotation)


def conditions(data: Measurements) -> np.ndarray:
    """Number the rows by what repeats have in common: pose, marker, payload, approach and applied wrench; (n_rows,)."""
    given = {
        "approach": [f"approach{i + 1}" for i in range(data.robot.n_joints)],
        "wrench": ["fx", "fy", "fz", "mx", "my", "mz"],
    }
    keys = ["pose", "marker", "payload", *(name for kind in given if kind in data.given for name in given[kind])]
    return data.table.groupby(keys, sort=False, dropna=False).ngroup().to_numpy()


def lack_of_fit(error: np.ndarray, sigma: np.ndarray, determined: float, robust: bool = False) -> LackOfFit:
    """Compare errors (n_rows, 3) with their noise (n_rows,); determined is the number of parameters they fixed.

    The discrepancy is what has to be added to the noise for chi² to equal its degrees of freedom; zero where the noise
    explains the errors (p above 1 %). After a robust fit, outliers are left out of it.
    """
    size = np.abs(error) / sigma[:, None]
    if robust:
        scale = max(1.0, float(np.median(size)) / NORMAL_MEDIAN)
        kept = (size < GROSS * scale).all(axis=1)
        error, sigma = error[kept], sigma[kept]
    degrees_of_freedom = max(1.0, error.size - determined)

    def chi_squared(discrepancy: float) -> float:
        return float(((error / np.hypot(sigma, discrepancy)[:, None]) ** 2).sum())

    found = chi_squared(0.0)
    p = float(chi2.sf(found, degrees_of_freedom))
    if p > SIGNIFICANT or found <= degrees_of_freedom:
        return LackOfFit(found / degrees_of_freedom, p, 0.0)
    largest = 10 * float(np.abs(error).max())
    return LackOfFit(
        found / degrees_of_freedom, p, brentq(lambda value: chi_squared(value) - degrees_of_freedom, 0.0, largest)
    )


def _pooled(data: Measurements) -> tuple[float, int]:
    train = data.only(data.train)
    if not len(train):
        return np.nan, 0
    group = conditions(train)
    count = np.bincount(group)
    degrees_of_freedom = 3 * (len(train) - len(count))
    if not degrees_of_freedom:
        return np.nan, 0
    nominal = build(train.robot, (), train.given)
    error = train.position - nominal.position(nominal.nominal, train.rows)
    means = np.stack([np.bincount(group, weights=axis) / count for axis in error.T], axis=1)
    apart = error - means[group]
    pooled = float(np.sqrt((apart**2).sum() / degrees_of_freedom))
    several = count[group] > 1
    shrunk = np.sqrt(1 - 1 / count[group][several])  # what taking a mean of few leaves of the scatter
    middle = float(np.median(np.abs(apart[several]) / shrunk[:, None])) / NORMAL_MEDIAN
    return (middle if pooled > BROKEN * middle > 0 else pooled), degrees_of_freedom
