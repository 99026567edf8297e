"""The measurement noise of each row, by the scatter of repeats of its pose or as stated, and the model's discrepancy beyond it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
import scipy

from calflow.estimation.accuracy import leading_errors, observing
from calflow.files.problems import refuse
from calflow.files.units import METRE, RADIAN, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units
from calflow.robot.frames import angles

# Share of a usual device's noise: repeats that scatter less are one reading written twice, and no robot's residuals are smaller.
LEAST_SCATTER = 1e-3
MIN_REPEATS = 10  # degrees of freedom below which repeats determine the noise too poorly
REPRESENTATIVE = 10_000  # rows beyond which further rows of the same kind no longer improve estimated variances
AT_LEAST = 300  # rows of each series, session and payload
GOLDEN = (5**0.5 - 1) / 2  # its multiples modulo 1 are equidistributed, and in step with no period (Weyl 1916)


def members(group: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each group, in their order; group (n_rows,) numbers them from 0 without gaps."""
    return np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the means (n, …) of values (n_rows, …) over each group of rows, numbered from 0 by group (n_rows,)."""
    columns = values.reshape(len(values), math.prod(values.shape[1:])).T
    sums = np.stack([np.bincount(group, weights=column) for column in columns], axis=1)
    return np.asarray((sums / np.bincount(group)[:, None]).reshape(-1, *values.shape[1:]))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Scatter of repeats about their means: each row's sum of squares (n_rows,) [unit²] and its degrees of freedom (n_rows,)."""

    squared: np.ndarray
    freedom: np.ndarray

    def only(self, rows: np.ndarray) -> Self:
        """Return the scatter of a subset of rows, given by a mask or by indices."""
        return replace(self, **{name: value[rows] for name, value in vars(self).items()})

    def gathered(self, group: np.ndarray) -> Scatter:
        """Return the scatter summed over groups of rows, numbered from 0 by group (n_rows,)."""
        return Scatter(np.bincount(group, weights=self.squared), np.bincount(group, weights=self.freedom))

    @property
    def sigma(self) -> float:
        """Pooled standard deviation per axis [unit]; nan where nothing was repeated."""
        return float(np.sqrt(self.squared.sum() / self.freedom.sum())) if self.freedom.sum() else float("nan")


def deviations(error: np.ndarray, group: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each row's deviation (n_rows, n_axes) from the mean of its group's kept rows (a mask), and their number."""
    count = np.bincount(group, weights=kept)
    sums = np.stack([np.bincount(group, weights=axis * kept) for axis in error.T], axis=1)
    return error - (sums / np.maximum(count, 1)[:, None])[group], count[group]


Source = Literal["repeats", "file", "estimated"]
Label = Literal["session", "marker"]  # the column that tells rows of a series apart whose noise may be another


@dataclass(frozen=True)
class PerUnit:
    """A standard deviation for each unit of the residuals [that unit]; 0 for a unit that is not listed."""

    sizes: tuple[tuple[MeasurementUnit, float], ...] = ()

    def __getitem__(self, unit: MeasurementUnit) -> float:
        return dict(self.sizes).get(unit, 0.0)

    def having(self, unit: MeasurementUnit, size: float) -> PerUnit:
        """Return a copy with the size of one unit replaced."""
        return PerUnit(tuple((dict(self.sizes) | {unit: size}).items()))


NO_DISCREPANCY = PerUnit()


@dataclass(frozen=True, eq=False)
class Noise:
    """The device's noise of each row, and the model's discrepancy, which is the same in all rows.

    sigma (n_rows,) [leading unit]: standard deviation per axis in the leading unit of the row's series, the first of its
    observation; units: the leading unit of each series (empty: all metres); rotation (n_rows,) [rad]: that of orientations beside
    positions (None: none were measured). Where the noise of a position is anisotropic, axes (n_rows, 3, 3) holds the
    principal directions of its covariance as rows and ratios (n_rows, 3) the standard deviations along them over sigma. sources:
    origin of each series' noise; series (n_rows,): index of each row's series (None: all of the first). intraclass: correlation
    of the errors about the model of positions measured at one standstill, axis by axis. scatter: that of repeats. corrected:
    whether a stated noise was too small in some rows.
    """

    sigma: np.ndarray
    sources: tuple[Source, ...]
    discrepancy: PerUnit = NO_DISCREPANCY
    units: tuple[MeasurementUnit, ...] = ()
    rotation: np.ndarray | None = None
    intraclass: float = 0.0
    axes: np.ndarray | None = None
    ratios: np.ndarray | None = None
    series: np.ndarray | None = None
    scatter: Scatter | None = None
    corrected: bool = False

    @property
    def known(self) -> bool:
        """Whether the noise of any series is known independently of the fit, so that a lack of fit can be told from noise."""
        return any(source != "estimated" for source in self.sources)

    def of_series(self, k: int) -> np.ndarray:
        """Mask of the rows of a series, shape (n_rows,)."""
        return np.full(len(self.sigma), k == 0) if self.series is None else np.asarray(self.series == k)

    @property
    def leading(self) -> tuple[MeasurementUnit, ...]:
        return self.units or (METRE,) * len(self.sources)

    def in_unit(self, unit: MeasurementUnit) -> np.ndarray:
        """Mask of the rows whose sigma is in a unit, shape (n_rows,)."""
        return self._by_series([leading == unit for leading in self.leading])

    @property
    def estimated(self) -> np.ndarray:
        """Mask of the rows whose noise is estimated from the fit's residuals, shape (n_rows,)."""
        return self._by_series([source == "estimated" for source in self.sources])

    def _by_series(self, values: Sequence[Any]) -> np.ndarray:
        return np.array(values)[np.zeros(len(self.sigma), dtype=int) if self.series is None else self.series]

    @property
    def usual(self) -> np.ndarray:
        """A usual device's noise in the unit of each row's sigma, shape (n_rows,)."""
        return self._by_series([unit.usual for unit in self.leading])

    @property
    def total(self) -> np.ndarray:
        """Standard deviation of noise and discrepancy together, in each row's leading unit, shape (n_rows,)."""
        return np.hypot(self.sigma, self._by_series([self.discrepancy[unit] for unit in self.leading]))

    def typical(self, unit: MeasurementUnit) -> float:
        """Return the root mean square of sigma over the rows with this leading unit; 0 where there are none."""
        sigma = self.sigma[self.in_unit(unit)]
        return float(np.sqrt(np.mean(sigma**2))) if len(sigma) else 0.0

    def principal(self, units: tuple[MeasurementUnit, ...]) -> np.ndarray:
        """Return the device's standard deviations along the principal axes of residuals in these units, (n_units, n_rows)."""
        turns = self.sigma if self.rotation is None or units[0] == RADIAN else self.rotation
        rows = [turns if unit == RADIAN else self.sigma for unit in units]
        if self.ratios is not None and in_space(units):
            rows[:3] = list(self.sigma * self.ratios.T)
        return np.array(rows)

    def about_model(self, units: tuple[MeasurementUnit, ...]) -> np.ndarray:
        """Return the root sum of squares of `principal` and the model's discrepancy, (n_units, n_rows)."""
        return np.hypot(self.principal(units), np.array([self.discrepancy[unit] for unit in units])[:, None])

    def whitening(self, units: tuple[MeasurementUnit, ...]) -> np.ndarray:
        """Return the whitening of residuals in these units: (n_units, n_rows), or (n_units², n_rows) where axes correlate.

        The latter holds one matrix per row in column-major order, which rotates residuals onto their principal axes.
        """
        weight = 1 / self.about_model(units)
        if self.axes is None or not in_space(units):
            return weight
        n = len(units)
        whole = np.zeros((len(self.sigma), n, n))
        whole[:, np.arange(n), np.arange(n)] = 1.0
        whole[:, :3, :3] = self.axes
        whole *= weight.T[:, :, None]
        return whole.transpose(2, 1, 0).reshape(n * n, -1)

    def only(self, rows: np.ndarray) -> Noise:
        """Return the noise of a subset of rows, given by a mask or by indices."""
        of_rows = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **of_rows, scatter=self.scatter and self.scatter.only(rows))

    @property
    def words(self) -> str:
        kinds = list(zip(self.sources, self.leading, strict=True))
        return "; ".join(self._words(*kind, [other == kind for other in kinds]) for kind in dict.fromkeys(kinds))

    def _words(self, source: Source, unit: MeasurementUnit, alike: Sequence[bool]) -> str:
        level = f"{unit.words(float(np.sqrt(np.mean(self.sigma[self._by_series(alike)] ** 2))))} per axis"
        return {
            "repeats": f"{level}, from repeated measurements of the fitted poses",
            "file": f"{level}, as the measurement file states it{', corrected where it is larger' * self.corrected}",
            "estimated": f"{level}, estimated from what the fit leaves; without repeats or a stated sigma a gap in the "
            "model looks like noise",
        }[source]


def in_space(units: tuple[MeasurementUnit, ...]) -> bool:
    """Whether the residuals' first three units, and no others, are metres: the components of a position."""
    return units[:3] == (METRE,) * 3 and units.count(METRE) == 3


NoiseSource = Literal["auto", "repeats", "file", "estimated"]


def measured_noise(data: Measurements, source: NoiseSource = "auto", nominal: Model | None = None) -> Noise:
    """Return the noise of each series from the best available source, or from the requested one.

    Repeats are pooled over training poses: sigma² is the sum of squares about each pose's mean over its degrees of
    freedom, after subtraction of the nominal prediction, so that joint readings may differ between repeats. nominal is the
    nominal robot with the data's observations.

    Raises:
        InputError: the source asked for is not in the data.
    """
    nominal = observing(nominal or Model(data.robot, (), data.given), data)
    error = leading_errors(nominal, nominal.nominal, data)
    stated = stated_noise(data)
    sigma, sources, scattered = stated.sigma.copy(), list[Source](), repeats_scatter(data, error)
    for k, series in enumerate(data.series):
        rows = data.of_series(k)
        there = not np.isnan(sigma[rows]).any()
        repeated, usual = scattered.only(data.train & rows), stated.leading[k].usual
        if source == "repeats" and not repeated.sigma > LEAST_SCATTER * usual:
            raise refuse('noise = "repeats" needs poses that were measured several times', key="stages.identify.noise")
        if source == "file" and not there:
            raise refuse(
                'noise = "file" needs a column sigma_mm, or sigma_mm in the study (in the unit that was measured)',
                key="stages.identify.noise",
            )
        enough = (
            repeated.freedom.sum() >= MIN_REPEATS and repeated.sigma > LEAST_SCATTER * usual and series.beam is None
        )
        if source == "repeats" or (source == "auto" and enough):
            sigma[rows] = repeated.sigma
            sources.append("repeats")
        elif there and source in ("auto", "file"):
            sources.append("file")
        else:
            # A start only: it weighs the data against the priors in the first fit.
            sigma[rows] = usual
            sources.append("estimated")
    return replace(stated, sigma=sigma, sources=tuple(sources), scatter=scattered)


def stated_noise(data: Measurements) -> Noise:
    """Return the noise stated by the measurement file and the study; sigma is nan where neither states it.

    Raises:
        InputError: orientations were measured without a stated standard deviation.
    """
    if data.rotation is not None and "sigma_rotation" not in data.table:
        raise refuse("expected how sure the measured orientations are [rad]", key="sigma_rotation")
    sigma = np.full(len(data), np.nan) if data.sigma is None else data.sigma.copy()
    axes, ratios = np.tile(np.eye(3), (len(data), 1, 1)), np.ones((len(data), 3))
    for k, series in enumerate(data.series):
        rows = data.of_series(k)
        if series.beam is not None and rows.any():
            values, vectors = np.linalg.eigh(series.beam.covariance(data.position[rows]))
            sigma[rows] = np.sqrt(values.mean(axis=1))
            axes[rows], ratios[rows] = vectors.transpose(0, 2, 1), np.sqrt(values) / sigma[rows][:, None]
    directed = any(series.beam is not None for series in data.series)
    return Noise(
        sigma, tuple[Source, ...]("file" for _ in data.series), axes=axes if directed else None,
        ratios=ratios if directed else None, units=leading_units(data),
        rotation=None if data.rotation is None else data.table["sigma_rotation"].to_numpy(),
        series=data.series_number if len(data.series) > 1 else None,
    )  # fmt: skip


def averaged(data: Measurements, noise: Noise) -> tuple[Measurements, Noise]:
    """Return the mean of each pose's repeats, which are one observation of the model's discrepancy, and the noise of the means."""
    group = data.repeated
    count = np.bincount(group)
    if (count == 1).all():
        return data, noise
    first = np.unique(group, return_index=True)[1]
    table = data.table.iloc[first].reset_index(drop=True)
    table["of_repeats"] = count
    for name in data.table.columns:
        if name not in ("pose", "repeat", "line") and data.table[name].dtype.kind == "f":
            table[name] = np.bincount(group, weights=data.table[name]) / count

    def of_means(sigma: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(np.bincount(group, weights=sigma**2)) / count)

    scattered = noise.scatter and noise.scatter.gathered(group)
    means = replace(noise.only(first), sigma=of_means(noise.sigma), scatter=scattered)
    if data.rotation is not None and noise.rotation is not None:
        oriented = np.isfinite(data.rotation).all(axis=(1, 2))
        turns = scipy.spatial.transform.Rotation.from_matrix(data.rotation[oriented])
        spread_angles = np.full((len(count), 3), np.nan)
        measured, group_of = np.unique(group[oriented], return_inverse=True)
        for k, rows in zip(measured, members(group_of), strict=True):
            spread_angles[k] = angles(turns[rows].mean())
        table = table.drop(columns=["qw", "qx", "qy", "qz"], errors="ignore")
        table[["rx", "ry", "rz"]] = spread_angles
        means = replace(means, rotation=of_means(noise.rotation))
        table["sigma_rotation"] = means.rotation
    return replace(data, table=table), means


def representative(data: Measurements, rows: int = REPRESENTATIVE) -> np.ndarray:
    """Return a mask (n_rows,) of about `rows` rows drawn evenly by whole standstills; all rows where there are no more."""
    if len(data) <= rows:
        return np.full(len(data), True)
    kinds = [name for name in ("series", "session", "payload") if name in data.table]
    kind = data.table.groupby(kinds, sort=False, dropna=False).ngroup().to_numpy()
    share = np.maximum(rows / len(data), AT_LEAST / np.bincount(kind))
    return np.asarray(data.standstill * GOLDEN % 1 < share[kind])


def repeats_scatter(data: Measurements, error: np.ndarray) -> Scatter:
    """Return the scatter of repeats by their `leading_errors` (n_rows, n_axes); rows of no split have none."""
    used = data.train | data.held_out
    apart, count = deviations(np.nan_to_num(error), data.repeated, used)
    freedom = (~np.isnan(error)).sum(axis=1) * (1 - 1 / np.maximum(count, 1))
    return Scatter(np.where(used, (apart**2).sum(axis=1), 0.0), np.where(used, freedom, 0.0))
