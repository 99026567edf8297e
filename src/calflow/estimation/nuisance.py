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
    if not any(lacking):
        return model, estimate
    points = model.point(estimate, data.rows)
    turned = model.rotation(estimate, data.rows)
    every = list[Observation]()
    for k, (observation, new) in enumerate(zip(model.observations, lacking, strict=True)):
        own = data.of_series(k)
        every.append(_extended(observation, points[own], turned[own], data, own) if new else observation)
    wider = replace(model, observations=tuple(every))
    known = dict(zip((parameter.name for parameter in model.parameters), estimate, strict=True))
    start = np.array([known.get(parameter.name, parameter.nominal) for parameter in wider.parameters])
    unknown = np.array([parameter.name not in known for parameter in wider.parameters])
    return wider, _settled(wider, start, unknown, data)


def _settled(model: Model, point: np.ndarray, new: np.ndarray, data: Measurements) -> np.ndarray:
    """Return the parameters with the new ones (a mask) where the rows of each series put them, all others held."""
    point = point.copy()
    for k, observation in enumerate(model.observations):
        own = data.of_series(k)
        columns = np.intersect1d(model.columns(observation), np.flatnonzero(new))
        if not len(columns) or not own.any():
            continue
        rows, reported = data.rows[:, own], observation.reported(data.table[own])
        sd = model.prior_sd[columns]
        for _ in range(TURNS):
            error = model.observed_error(observation, point, rows, reported).ravel()
            slope = model.observed_jacobian(observation, point, rows, reported)[:, :, columns].reshape(len(error), -1)
            there = np.isfinite(error)
            point[columns] -= sd * np.linalg.lstsq(slope[there] * sd, error[there], rcond=1e-9)[0]
    return point


def _extended(
    observation: Observation, points: np.ndarray, turned: np.ndarray, data: Measurements, own: np.ndarray
) -> Observation:
    table = data.table[own]
    placed = observation.extended(table).registered(points, turned, table)
    before = {one.what: one for one in observation.placements}
    return placed.placed({one.what: before.get(one.what, one) for one in placed.placements})
