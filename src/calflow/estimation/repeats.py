"""Repeats: rows of one pose measured again under the same conditions, and what their scatter says of the noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.estimation.accuracy import leading_errors
from calflow.estimation.groups import members
from calflow.estimation.noise import LEAST_SCATTER, Noise, Pooled, Scatter, Source, pooled, scatter
from calflow.estimation.nuisance import observing
from calflow.files.problems import refuse
from calflow.files.units import RADIAN
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units
from calflow.robot.frames import angles

MIN_REPEATS = 10  # degrees of freedom below which repeats say too little


NoiseSource = Literal["auto", "repeats", "file", "estimated"]


def measured_noise(data: Measurements, source: NoiseSource = "auto", nominal: Model | None = None) -> Noise:
    """Return the noise of each series: see `noise_beside`; nominal is the robot as its maker says, with the data's observations.

    Raises:
        InputError: the source asked for is not in the data.
    """
    nominal = observing(nominal or Model(data.robot, (), data.given), data)
    return noise_beside(leading_errors(nominal, nominal.nominal, data), data, source)


def noise_beside(error: np.ndarray, data: Measurements, source: NoiseSource = "auto") -> Noise:
    """Return the noise of each series by the best source there is, or by the one asked for.

    Repeats are pooled over training poses: sigma² is the sum of squares about each pose's mean over its degrees of
    freedom, after the nominal robot's part is taken off, so that repeats need not stand at the very same readings. Gross
    errors are left out of it (see `scatter.pooled`). error are the nominal robot's `leading_errors`.

    Raises:
        InputError: the source asked for is not in the data.
    """
    stated = stated_noise(data)
    sigma, sources = stated.sigma.copy(), list[Source]()
    for k, series in enumerate(data.series):
        own = data.of_series(k)
        there = not np.isnan(sigma[own]).any()
        found, usual = pooled_repeats(data, error, own), stated.leading[k].usual
        if source == "repeats" and not found.sigma > LEAST_SCATTER * usual:
            raise refuse('noise = "repeats" needs poses that were measured several times', key="stages.identify.noise")
        if source == "file" and not there:
            raise refuse(
                'noise = "file" needs a column sigma_mm, or sigma_mm in the study (in the unit that was measured)',
                key="stages.identify.noise",
            )
        enough = found.freedom >= MIN_REPEATS and found.sigma > LEAST_SCATTER * usual and series.beam is None
        if source == "repeats" or (source == "auto" and enough):
            sigma[own] = found.sigma
            sources.append("repeats")
        elif there and source in ("auto", "file"):
            sources.append("file")
        else:
            sigma[own] = usual  # only the weight of the data against the priors in the very first fit
            sources.append("estimated")
    return replace(stated, sigma=sigma, sources=tuple(sources), scatter=repeats_scatter(data, error))


def stated_noise(data: Measurements) -> Noise:
    """Return the noise as file and study state it; sigma is nan where they do not.

    Raises:
        InputError: orientations were measured, and it is not stated how surely.
    """
    if data.rotation is not None and "sigma_rotation" not in data.table:
        raise refuse("expected how sure the measured orientations are [rad]", key="sigma_rotation")
    sigma = np.full(len(data), np.nan) if data.sigma is None else data.sigma.copy()
    axes, ratios = np.tile(np.eye(3), (len(data), 1, 1)), np.ones((len(data), 3))
    for k, series in enumerate(data.series):
        if series.beam is not None:
            own = data.of_series(k)
            values, vectors = np.linalg.eigh(series.beam.covariance(data.position[own]))
            sigma[own] = np.sqrt(values.mean(axis=1))
            axes[own], ratios[own] = vectors.transpose(0, 2, 1), np.sqrt(values) / sigma[own][:, None]
    directed = any(series.beam is not None for series in data.series)
    return Noise(
        sigma, tuple[Source, ...]("file" for _ in data.series), axes=axes if directed else None,
        ratios=ratios if directed else None, units=leading_units(data),
        further=((RADIAN, data.table["sigma_rotation"].to_numpy()),) if data.rotation is not None else (),
        series=data.series_number if len(data.series) > 1 else None,
    )  # fmt: skip


def averaged(data: Measurements, noise: Noise) -> tuple[Measurements, Noise]:
    """Return the mean of each pose's repeats (see `conditions`), and the noise of the means.

    The model's discrepancy is the same in all repeats of a pose, so that together they are one piece of evidence.
    """
    group = conditions(data)
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

    scattered = None if noise.scatter is None else noise.scatter.gathered(group)
    means = replace(noise.only(first), sigma=of_means(noise.sigma), scatter=scattered)
    if data.rotation is not None and noise.further:
        oriented = np.isfinite(data.rotation).all(axis=(1, 2))
        turns = Rotation.from_matrix(data.rotation[oriented])
        found = np.full((len(count), 3), np.nan)
        measured, own = np.unique(group[oriented], return_inverse=True)
        for k, rows in zip(measured, members(own), strict=True):
            found[k] = angles(turns[rows].mean())
        table = table.drop(columns=["qw", "qx", "qy", "qz"], errors="ignore")
        table[["rx", "ry", "rz"]] = found
        means = replace(means, further=tuple((unit, of_means(sigma)) for unit, sigma in noise.further))
        table["sigma_rotation"] = dict(means.further)[RADIAN]
    return replace(data, table=table), means


def conditions(data: Measurements) -> np.ndarray:
    """Number the rows by what repeats have in common; (n_rows,).

    That is series, session, pose, marker, payload, what was touched, approach and applied wrench.
    """
    return data.table.groupby([*_of_standstill(data), "marker"], sort=False, dropna=False).ngroup().to_numpy()


def standstills(data: Measurements) -> np.ndarray:
    """Number the rows by the standstill they were measured at, which markers may share, and repeats; (n_rows,)."""
    return data.table.groupby(_of_standstill(data), sort=False, dropna=False).ngroup().to_numpy()


def _of_standstill(data: Measurements) -> list[str]:
    given = {
        "approach": [f"approach{i + 1}" for i in range(data.robot.n_joints)],
        "wrench": ["fx", "fy", "fz", "mx", "my", "mz"],
    }
    keys = ["pose", "payload", *(name for kind in given if kind in data.given for name in given[kind])]
    labels = [name for series in data.series for name in series.labels]
    return keys + [name for name in dict.fromkeys(["series", "session", *labels]) if name in data.table]


def pooled_repeats(data: Measurements, error: np.ndarray, own: np.ndarray) -> Pooled:
    """Pool the scatter of `leading_errors` (n_rows, n_axes) among the repeats of some training rows (n_rows,)."""
    kept = data.train & own
    if not kept.any():
        return Pooled(float("nan"), 0.0, np.zeros(0, dtype=bool))
    return pooled(_values(error[kept]), _groups(data, kept))


def repeats_scatter(data: Measurements, error: np.ndarray) -> Scatter:
    """Return what the `leading_errors` (n_rows, n_axes) of each row's repeats scatter; rows of no split have none."""
    found = Scatter(np.zeros(len(data)), np.zeros(len(data)), np.zeros(len(data), dtype=bool))
    for k in range(len(data.series)):
        for split in (data.train, data.held_out):
            own = data.of_series(k) & split
            if own.any():
                part = scatter(_values(error[own]), _groups(data, own))
                found.squared[own], found.freedom[own], found.gross[own] = part.squared, part.freedom, part.gross
    return found


def _values(error: np.ndarray) -> np.ndarray:
    """What was measured, of errors (n_rows, n_axes) that have nan elsewhere."""
    return np.asarray(error[:, ~np.isnan(error).all(axis=0)])


def _groups(data: Measurements, own: np.ndarray) -> np.ndarray:
    """Number some rows by what their repeats have in common, from 0."""
    return np.unique(conditions(data.only(own)), return_inverse=True)[1]
