"""Accuracy: how far what is predicted is from what was measured."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.estimation.nuisance import completed, observing
from calflow.measurements.measurements import Measurements
from calflow.model import Model


def errors(model: Model, estimate: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return predicted minus measured lengths of each row, shape (n_rows, 3) [m].

    That is the position's three axes; a row of which one length was measured has it first, and nan besides.
    """
    model, estimate = completed(model, estimate, measured)
    found = np.full((len(measured), 3), np.nan)
    for k, observation in enumerate(model.observations):
        rows = np.flatnonzero(measured.of_series(k))
        lengths = [i for i, unit in enumerate(observation.units) if unit == "m"]
        error = model.observed_error(
            observation, estimate, measured.rows[:, rows], observation.reported(measured.table.iloc[rows])
        )
        found[rows[:, None], np.arange(len(lengths))] = error[:, lengths]
    return found


def error_jacobian(model: Model, estimate: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return the derivatives of `errors`, shape (n_rows, 3, n_parameters), zero where nothing was measured."""
    model = observing(model, measured)
    found = np.zeros((len(measured), 3, len(estimate)))
    for k, observation in enumerate(model.observations):
        rows = np.flatnonzero(measured.of_series(k))
        lengths = [i for i, unit in enumerate(observation.units) if unit == "m"]
        reported = observation.reported(measured.table.iloc[rows])
        slope = model.observed_jacobian(observation, estimate, measured.rows[:, rows], reported)
        found[rows[:, None], np.arange(len(lengths))] = slope[:, lengths]
    return found


def distances(error: np.ndarray) -> np.ndarray:
    """Return the length of each row's error (n_rows, 3), shape (n_rows,)."""
    return np.asarray(np.sqrt(np.nansum(error**2, axis=1)))


def residual_table(measured: Measurements, error: np.ndarray) -> pd.DataFrame:
    """Return the first columns of residuals.csv: which row, and its error (n_rows, 3) along x, y, z (if it has axes) and in all."""
    table = measured.table[["pose", "repeat", "marker"]].copy()
    whole = ~np.isnan(error).any(axis=1)
    for i, axis in enumerate("xyz"):
        table[f"d{axis}_mm"] = np.where(whole, 1e3 * error[:, i], np.nan)
    return table.assign(error_mm=1e3 * distances(error))


def accuracy(name: str, error: np.ndarray, measured: Measurements) -> list[dict[str, object]]:
    """Return one row a split of the table accuracy.csv: model, split, n, mean_mm, rms_mm, max_mm."""
    distance = 1e3 * distances(error)
    rows = []
    for split in ("train", "holdout"):
        part = distance[(measured.table["split"] == split).to_numpy()]
        if len(part):
            rows.append({"model": name, "split": split, "n": len(part), "mean_mm": part.mean(),
                         "rms_mm": np.sqrt((part**2).mean()), "max_mm": part.max()})  # fmt: skip
    return rows
