"""Accuracy: how far what is predicted is from what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.estimation.nuisance import completed, observing
from calflow.files.tables import column, typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import Observation


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """How far a model's predicted positions are from the measured ones, on one split."""

    model: str = column("what the model has: `nominal`, or its effects, in order, with ` + ` between them")
    split: Literal["train", "holdout"] = column("rows that were fitted, or held out")
    n: int = column("number of rows")
    mean_mm: float = column("mean distance from predicted to measured position", "mm")
    rms_mm: float = column("root mean square of that distance", "mm")
    max_mm: float = column("largest distance", "mm")
    step: int = column("number of effects and causes in the model, 0: nominal")
    effect: str = column("what the model has more than that of the step before; empty: nominal", default="")
    joint: int | None = column("number of its joint or link, where it is a cause of one", default=None)
    part: str = column("the part of the robot that it is a cause of; empty: all", default="")
    detail: str = column("its variant, in words", default="")


@dataclass(frozen=True, kw_only=True)
class Residual:
    """What a model leaves of a measured row."""

    pose: str = column("as in the measurements")
    repeat: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    dx_mm: float = column(
        "predicted minus measured position, along the measuring frame's x; empty: no position was measured", "mm"
    )
    dy_mm: float = column("the same along y", "mm")
    dz_mm: float = column("the same along z", "mm")
    error_mm: float = column("size of the error, also of what is no position", "mm")
    split: str = column("train, holdout; empty: left out as faulty")
    line: int = column("line of the measurement file")


def errors(model: Model, estimate: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return predicted minus measured lengths of each row, shape (n_rows, 3) [m].

    That is the position's, along the measuring frame's axes; a row of which one length was measured has it first, and nan
    besides.
    """
    model, estimate = completed(model, estimate, measured)
    found = np.full((len(measured), 3), np.nan)
    for k, observation in enumerate(model.observations):
        rows = np.flatnonzero(measured.of_series(k))
        lengths = [i for i, unit in enumerate(observation.units) if unit == "m"]
        error = model.observed_error(
            observation, estimate, measured.rows[:, rows], observation.reported(measured.table.iloc[rows])
        )
        turned = _turned(observation, model, estimate, measured.table.iloc[rows], error[:, lengths, None])
        found[rows[:, None], np.arange(len(lengths))] = turned[:, :, 0]
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
        turned = _turned(observation, model, estimate, measured.table.iloc[rows], slope[:, lengths])
        found[rows[:, None], np.arange(len(lengths))] = turned
    return found


def _turned(
    observation: Observation, model: Model, estimate: np.ndarray, table: pd.DataFrame, values: np.ndarray
) -> np.ndarray:
    """Return what a row has along a device's axes (n_rows, n_lengths, …) along the measuring frame's."""
    axes = observation.axes(model.values(observation, estimate), table)
    return values if axes is None else axes @ values


def distances(error: np.ndarray) -> np.ndarray:
    """Return the length of each row's error (n_rows, 3), shape (n_rows,)."""
    return np.asarray(np.sqrt(np.nansum(error**2, axis=1)))


def accuracy(
    name: str, error: np.ndarray, measured: Measurements, step: int = 0, added: Effect | None = None
) -> list[Accuracy]:
    """Return a row a split of a model's errors (n_rows, 3) [m]; added is what the model has more than the one before."""
    distance = 1e3 * distances(error)
    what = {"effect": added.id, "detail": added.detail} if added else {}
    where = {"joint": added.joint or None, "part": added.part} if isinstance(added, Cause) else {}
    rows = []
    for split in ("train", "holdout"):
        part = distance[(measured.table["split"] == split).to_numpy()]
        if len(part):
            size = {"mean_mm": part.mean(), "rms_mm": np.sqrt((part**2).mean()), "max_mm": part.max()}
            rows.append(Accuracy(model=name, split=split, n=len(part), **size, step=step, **what, **where))  # type: ignore[arg-type]
    return rows


def residuals(error: np.ndarray, data: Measurements) -> pd.DataFrame:
    """Return the table of `Residual`s for errors (n_rows, 3) [m]."""
    whole = ~np.isnan(error).any(axis=1)
    own = {f"d{axis}_mm": np.where(whole, 1e3 * error[:, i], np.nan) for i, axis in enumerate("xyz")}
    told = data.table[["pose", "repeat", "marker", "split", "line"]]
    return typed(told.assign(**own, error_mm=1e3 * distances(error)), Residual)
