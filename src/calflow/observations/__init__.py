"""Observations: what a device reports of a row, one kind a file."""

from __future__ import annotations

from functools import lru_cache

import pandas as pd

from calflow.files import plugins
from calflow.files.units import MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.observations.base import Observation, Seen
from calflow.observations.position import Position

__all__ = ["Observation", "Seen", "leading_units", "observation_kinds", "observations"]


@lru_cache
def observation_kinds() -> dict[str, type[Observation]]:
    """Return every kind of observation by its id: a new file in this folder is enough, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    return plugins.catalogue_of(__name__, plugins.OBSERVATIONS, Observation, _flaw)  # type: ignore[type-abstract]


def _flaw(kind: type[Observation]) -> str:
    """What is wrong with the units of a kind that another package brings; empty where nothing is."""
    units = getattr(kind, "units", ())
    if units and all(isinstance(unit, MeasurementUnit) for unit in units):
        return ""
    return "its units say nothing of how a residual is told: expected a calflow.files.units.MeasurementUnit each, such as METRE"


def observations(data: Measurements) -> tuple[Observation, ...]:
    """Return what was observed in each of the data's series, nothing placed yet.

    The first station is the measuring frame; another of the same name stands where it does.
    """
    found: list[Observation] = []
    first: str | None = None
    for k, series in enumerate(data.series):
        table = data.table[data.of_series(k)]
        kind = _kind(series, table)
        if issubclass(kind, Position):
            first = series.station.name if first is None else first
            found.append(kind.of(series, table, series.station.name == first))
        else:
            found.append(kind.of(series, table))
    return tuple(found)


def leading_units(data: Measurements) -> tuple[MeasurementUnit, ...]:
    """Return for each of the data's series the unit that its noise is stated in: that of its first residual."""
    return tuple(_kind(series, data.table).units[0] for series in data.series)


def _kind(series: Series, table: pd.DataFrame) -> type[Observation]:
    """What kind of observation the rows of a series are."""
    return observation_kinds()[series.kind or ("pose" if {"rx", "qw"} & set(table) else "position")]
