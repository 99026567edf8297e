"""Accuracy: the distance of a model's predictions from the measurements.

Nuisance parameters that no fitted row determines, as the place of a new station or socket, are estimated first from the new rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import blocks_of
from calflow.model import Model
from calflow.observations import Observation, leading_units, observations

# A method of the model: values (n, n_units, …) of an observation at an estimate, of packed rows with what was reported of them.
Values = Callable[[Observation, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
TURNS = 4  # Gauss-Newton iterations, which start from the registered values
NAN = float("nan")
RESAMPLES = 2000  # of the poses, for the interval of a gain
INTERVAL = (0.025, 0.975)


def observing(model: Model, data: Measurements) -> Model:
    """Return the model with the data's observations, if it has none."""
    return model if model.observations else replace(model, observations=observations(data))


def completed(model: Model, estimate: np.ndarray, data: Measurements) -> tuple[Model, np.ndarray]:
    """Return a model and its estimate with the nuisance parameters of new rows, placed by these with the robot held."""
    model = observing(model, data)
    lacking = [o.lacks(data.table[data.of_series(k)]) for k, o in enumerate(model.observations)]
    further = tuple(more for effect in model.effects for more in effect.completing(data))
    if not any(lacking) and not further:
        return model, estimate
    every = list[Observation]()
    for k, (observation, new) in enumerate(zip(model.observations, lacking, strict=True)):
        if new:
            rows = data.only(data.of_series(k))
            placed = registered_on(observation.extended(rows.table), rows, model, estimate)
            observation = placed.placed(placed.placements | observation.placements)
        every.append(observation)
    wider = replace(model, observations=tuple(every), effects=(*model.effects, *further))
    estimates = dict(zip((parameter.name for parameter in model.parameters), estimate, strict=True))
    start = np.array([estimates.get(parameter.name, parameter.nominal) for parameter in wider.parameters])
    unknown = np.array([parameter.name not in estimates for parameter in wider.parameters])
    return wider, _settled(wider, start, unknown, data)


def _settled(model: Model, point: np.ndarray, new: np.ndarray, data: Measurements) -> np.ndarray:
    """Return the parameters with the new ones (a mask) fitted by Gauss-Newton, each series' first, then those that all share."""
    point, every = point.copy(), _observed_series(model, data)
    of_series = [np.intersect1d(model.columns(observation), np.flatnonzero(new)) for observation in model.observations]
    of_effects = np.setdiff1d(np.flatnonzero(new), np.concatenate(of_series))
    for columns, series in (*zip(of_series, ([seen] for seen in every), strict=True), (of_effects, every)):
        if not len(columns) or not any(len(seen.rows) for seen in series):
            continue
        sd = model.prior_sd[columns]
        for _ in range(TURNS):
            error = np.concatenate([seen.values(model.observed_error, point).ravel() for seen in series])
            slopes = (seen.values(model.observed_jacobian, point)[:, :, columns] for seen in series)
            slope = np.concatenate([of_series.reshape(-1, len(columns)) for of_series in slopes])
            there = np.isfinite(error)
            point[columns] -= sd * np.linalg.lstsq(slope[there] * sd, error[there], rcond=1e-9)[0]
    return point


def registered_on(observation: Observation, rows: Measurements, model: Model, estimate: np.ndarray) -> Observation:
    """Return an observation with its objects placed by the rows of its series and a model (see `Observation.registered`)."""
    links = partial(model.link, p=estimate, conditions=rows.conditions)
    return observation.registered(model.point(estimate, rows.conditions), links, rows.table)


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Accuracy of a model on one split, over the series that report in one unit."""

    model: str = column("the model: `nominal`, or its effects, in order, with ` + ` between them")
    split: Literal["train", "holdout"] = column("rows that were fitted, or held out")
    n: int = column("number of rows")
    mean_mm: float = column(
        "mean distance from predicted to measured position, or error of a length; empty: `unit` is another",
        "mm",
        default=NAN,
    )
    rms_mm: float = column("root mean square of that distance", "mm", default=NAN)
    max_mm: float = column("largest distance", "mm", default=NAN)
    step: int = column("number of effects and causes in the model, 0: nominal")
    effect: str = column("the effect added in this step; empty: nominal", default="")
    joint: int | None = column("number of its joint or link, where it is a cause of one", default=None)
    part: str = column("the part of the robot that it is a cause of; empty: all", default="")
    detail: str = column("its variant, in words", default="")
    unit: str = column("the unit that mean, rms and max are in: mm, mrad, px, …", default=METRE.label)
    mean: float = column("mean size of the error, in `unit`", default=NAN)
    rms: float = column("root mean square of that size, in `unit`", default=NAN)
    max: float = column("largest size, in `unit`", default=NAN)

    @property
    def figures(self) -> tuple[float, float, float]:
        """Mean, root mean square and largest size [unit]."""
        if self.unit == METRE.label:
            return self.mean_mm, self.rms_mm, self.max_mm
        return self.mean, self.rms, self.max


@dataclass(frozen=True, kw_only=True)
class Residual:
    """The residual of a measured row: predicted minus measured."""

    pose: str = column("as in the measurements")
    repeat: str = column("as in the measurements")
    marker: str = column("as in the measurements")
    dx_mm: float = column(
        "predicted minus measured position, along the measuring frame's x; empty: no position was measured", "mm"
    )
    dy_mm: float = column("the same along y", "mm")
    dz_mm: float = column("the same along z", "mm")
    error_mm: float = column("size of the error, also of a length that is no position; empty: `unit` is another", "mm")
    split: str = column("train, holdout; empty: left out as faulty")
    line: int = column("line of the measurement file")
    error: float = column("size of the error, in `unit`")
    unit: str = column("the unit that the error is in: mm, mrad, px, …")


def judged_unit(units: Sequence[MeasurementUnit]) -> MeasurementUnit:
    """Return the unit by which a model is judged: metres if a series has them as its leading unit, else the first unit."""
    return METRE if METRE in units else units[0]


def errors(
    model: Model, estimate: np.ndarray, measured: Measurements, unit: MeasurementUnit | None = None
) -> np.ndarray:
    """Return predicted minus measured values of each row, shape (n_rows, 3 or more) [unit]; nan where a row has no such value.

    Errors of positions are along the measuring frame's axes. Columns hold, from the first on, the values in the leading unit of the
    row's series, the first of its observation. unit is by default the one by which the model is judged.
    """
    return _masked(leading_errors(model, estimate, measured), measured, unit)


def leading_errors(model: Model, estimate: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return the errors as `errors` does, those of each row in the leading unit of its series."""
    model, estimate = completed(model, estimate, measured)
    return _in_leading_units(model.observed_error, model, estimate, _observed_series(model, measured))


def errors_of_draws(model: Model, draws: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return the `errors` of estimates (n_draws, n_parameters), shape (n_draws, n_rows, 3 or more); rows are looked up once."""
    model = observing(model, measured)
    if completed(model, draws[0], measured)[0] is not model:  # each draw places anew what no fitted row saw
        return np.array([errors(model, draw, measured) for draw in draws])
    every = _observed_series(model, measured)
    values = [_in_leading_units(model.observed_error, model, draw, every) for draw in draws]
    return _masked(np.stack(values, axis=1), measured).swapaxes(0, 1)


@dataclass(frozen=True, eq=False)
class _ObservedSeries:
    """The rows of one series as its observation reports them; rows (n,) are their indices among all rows."""

    observation: Observation
    rows: np.ndarray
    table: pd.DataFrame
    conditions: np.ndarray
    reported: np.ndarray

    def values(self, of: Values, estimate: np.ndarray) -> np.ndarray:
        return of(self.observation, estimate, self.conditions, self.reported)


def _observed_series(model: Model, measured: Measurements) -> list[_ObservedSeries]:
    series = []
    for k, observation in enumerate(model.observations):
        rows = np.flatnonzero(measured.of_series(k))
        table = measured.table.iloc[rows]
        reported = observation.reported(table) if len(rows) else np.zeros((observation.reports, 0))
        series.append(_ObservedSeries(observation, rows, table, measured.conditions[:, rows], reported))
    return series


def error_jacobian(
    model: Model, estimate: np.ndarray, measured: Measurements, unit: MeasurementUnit | None = None
) -> np.ndarray:
    """Return the Jacobian of `errors`, shape (n_rows, 3 or more, n_parameters), zero where `errors` has nan."""
    model = observing(model, measured)
    jacobian = _in_leading_units(model.observed_jacobian, model, estimate, _observed_series(model, measured))
    return np.nan_to_num(_masked(jacobian, measured, unit))


def _in_leading_units(
    values: Values, model: Model, estimate: np.ndarray, every: Sequence[_ObservedSeries]
) -> np.ndarray:
    """Return values of all rows in their series' leading unit, along the measuring frame, (n_rows, 3 or more, …), else nan."""
    leading = [
        [k for k, unit in enumerate(seen.observation.units) if unit == seen.observation.units[0]] for seen in every
    ]
    parts = [seen.values(values, estimate) for seen in every]
    whole = np.full((sum(map(len, parts)), max(3, *map(len, leading)), *parts[0].shape[2:]), np.nan)
    for seen, own, part in zip(every, leading, parts, strict=True):
        axes, part = seen.observation.axes(model.values(seen.observation, estimate), seen.table), part[:, own]
        turned = part if axes is None else np.einsum("nij,nj...->ni...", axes, part)
        whole[seen.rows[:, None], np.arange(len(own))] = turned
    return whole


def _masked(values: np.ndarray, measured: Measurements, unit: MeasurementUnit | None = None) -> np.ndarray:
    """Return values (n_rows, …) with nan in the rows of series with another leading unit."""
    units = leading_units(measured)
    unit = unit or judged_unit(units)
    values[np.isin(measured.series_number, [k for k, other in enumerate(units) if other != unit])] = np.nan
    return values


def distances(error: np.ndarray) -> np.ndarray:
    """Return the length of each row's error (n_rows, n_axes), shape (n_rows,); nan where it has none."""
    return np.where(np.isnan(error).all(axis=1), np.nan, np.sqrt(np.nansum(error**2, axis=1)))


def mean_rms_max(size: np.ndarray) -> tuple[float, float, float]:
    """Return the mean, the root mean square and the largest of sizes (n,)."""
    return float(size.mean()), float(np.sqrt((size**2).mean())), float(size.max())


def spread_mm(points: np.ndarray) -> float:
    """Return the mean distance of points (n, 3) [m] from their centroid, in mm."""
    return 1e3 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())


def accuracy(
    name: str, error: np.ndarray, measured: Measurements, step: int = 0, added: Effect | None = None
) -> list[Accuracy]:
    """Return one row per unit and split, from a model's `leading_errors`, nan where not judged; added: this step's effect."""
    what = {"effect": added.id, "detail": added.detail} if added else {}
    where = {"joint": added.joint or None, "part": added.part} if isinstance(added, Cause) else {}
    leading, judged = leading_units(measured), residuals(error, measured).dropna(subset="error")
    rows = []
    for unit in dict.fromkeys((judged_unit(leading), *leading)):
        for split in ("train", "holdout"):
            part = judged["error"][(judged["unit"] == unit.label) & (judged["split"] == split)].to_numpy()
            if len(part):
                figures = dict(zip(("mean", "rms", "max"), mean_rms_max(part), strict=True))
                lengths = {f"{figure}_mm": value for figure, value in figures.items() if unit == METRE}
                rows.append(Accuracy(model=name, split=split, n=len(part), step=step, unit=unit.label,
                                     **lengths, **figures, **what, **where))  # type: ignore[arg-type]  # fmt: skip
    return rows


def gain(
    before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return the reduction of the mean held-out error between two models' `errors` (n_rows, n_axes), and its 95 % interval.

    It is by a bootstrap of whole poses, which are resampled within payload and session; nan where nothing is held out.
    """
    fallen = distances(before) - distances(after)
    there = np.isfinite(fallen)
    if not there.any():
        return NAN, NAN, NAN
    blocks, fallen = blocks_of(heldout.table), fallen[there]
    table = heldout.table.loc[there, ["pose", *blocks]].assign(fallen=fallen)
    poses = table.groupby("pose", sort=True).agg(
        total=("fallen", "sum"), n=("fallen", "size"), **{name: (name, "first") for name in blocks}
    )
    total, count = np.zeros(RESAMPLES), np.zeros(RESAMPLES)
    for _, group in poses.groupby(blocks, sort=True):
        drawn = rng.integers(len(group), size=(RESAMPLES, len(group)))
        total += group["total"].to_numpy()[drawn].sum(axis=1)
        count += group["n"].to_numpy()[drawn].sum(axis=1)
    low, high = np.quantile(total / count, INTERVAL)
    return float(fallen.mean()), float(low), float(high)


def residuals(error: np.ndarray, data: Measurements) -> pd.DataFrame:
    """Return the table of `Residual`s for `leading_errors` (n_rows, n_axes)."""
    units, series = leading_units(data), data.series_number
    lengths = np.array([unit == METRE for unit in units])[series]
    size = np.array([unit.scale for unit in units])[series] * distances(error)
    whole = lengths & ~np.isnan(error[:, :3]).any(axis=1)
    components = {f"d{axis}_mm": np.where(whole, 1e3 * error[:, i], np.nan) for i, axis in enumerate("xyz")}
    kept = data.table[["pose", "repeat", "marker", "split", "line"]]
    label = np.array([unit.label for unit in units])[series]
    return typed(kept.assign(**components, error_mm=np.where(lengths, size, np.nan), error=size, unit=label), Residual)
