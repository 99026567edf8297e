"""Nuisance parameters: where stations are, and what was touched, that no fitted row was of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import Observation, observations

TURNS = 4  # of Gauss and Newton, from what is registered already


def observing(model: Model, data: Measurements) -> Model:
    """Return the model with the data's observations, if it has none."""
    return model if model.observations else replace(model, observations=observations(data))


def completed(model: Model, estimate: np.ndarray, data: Measurements) -> tuple[Model, np.ndarray]:
    """Return a model and its estimate for rows of things that it does not know yet.

    A new socket or session is placed by its own rows, with the robot as it was estimated: what they say of each other is
    judged, where the thing is is not.
    """
    model = observing(model, data)
    lacking = [o.lacks(data.table[data.of_series(k)]) for k, o in enumerate(model.observations)]
    further = tuple(more for effect in model.effects for more in effect.completing(data))
    if not any(lacking) and not further:
        return model, estimate
    points = model.point(estimate, data.conditions)
    turned = model.rotation(estimate, data.conditions)
    every = list[Observation]()
    for k, (observation, new) in enumerate(zip(model.observations, lacking, strict=True)):
        own = data.of_series(k)
        every.append(_extended(observation, points[own], turned[own], data, own) if new else observation)
    wider = replace(model, observations=tuple(every), effects=(*model.effects, *further))
    known = dict(zip((parameter.name for parameter in model.parameters), estimate, strict=True))
    start = np.array([known.get(parameter.name, parameter.nominal) for parameter in wider.parameters])
    unknown = np.array([parameter.name not in known for parameter in wider.parameters])
    return wider, _settled(wider, start, unknown, data)


def _settled(model: Model, point: np.ndarray, new: np.ndarray, data: Measurements) -> np.ndarray:
    """Return the parameters with the new ones (a mask) where the rows put them, all others held.

    First are those of each series, then those of the effects, which all series share.
    """
    point = point.copy()
    every = range(len(model.observations))
    of_series = [np.intersect1d(model.columns(observation), np.flatnonzero(new)) for observation in model.observations]
    of_effects = np.setdiff1d(np.flatnonzero(new), np.concatenate(of_series))
    for columns, series in (*zip(of_series, ([k] for k in every), strict=True), (of_effects, list(every))):
        if not len(columns) or not any(data.of_series(k).any() for k in series):
            continue
        sd = model.prior_sd[columns]
        for _ in range(TURNS):
            parts = [_linearised(model, point, data, k, columns) for k in series]
            error, slope = (np.concatenate(of) for of in zip(*parts, strict=True))
            there = np.isfinite(error)
            point[columns] -= sd * np.linalg.lstsq(slope[there] * sd, error[there], rcond=1e-9)[0]
    return point


def _linearised(
    model: Model, point: np.ndarray, data: Measurements, series: int, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a series' rows (n,), and their derivatives by some parameters (n, n_columns)."""
    observation, own = model.observations[series], data.of_series(series)
    conditions, reported = data.conditions[:, own], observation.reported(data.table[own])
    error = model.observed_error(observation, point, conditions, reported).ravel()
    slope = model.observed_jacobian(observation, point, conditions, reported)[:, :, columns]
    return error, slope.reshape(len(error), len(columns))


def _extended(
    observation: Observation, points: np.ndarray, turned: np.ndarray, data: Measurements, own: np.ndarray
) -> Observation:
    table = data.table[own]
    placed = observation.extended(table).registered(points, turned, table)
    before = {one.what: one for one in observation.placements}
    return placed.placed({one.what: before.get(one.what, one) for one in placed.placements})
