"""Writing of records as TOML: in everyday units, with default values omitted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from calflow.files.toml import UNKNOWN, FileModel, Record, defaults, dimensions
from calflow.files.units import KEY_SUFFIXES, in_si, to_si
from calflow.files.writing import write_text


def write_toml(path: Path, file: FileModel) -> None:
    """Write a file model, without its default values, such that `read_toml` reads it back equal."""
    write_text(path, tomli_w.dumps(table_of(file)))


def table_of(record: FileModel | Record, **other: str) -> dict[str, Any]:
    """Return the TOML table of a record, without default values and in everyday units.

    A value that would not read back exactly in its everyday unit is in SI. other overrides the dimensions of fields.
    """
    table: dict[str, Any] = {}
    for name, default in defaults(type(record)).items():
        value, dimension = getattr(record, name), other.get(name) or dimensions(type(record))[name]
        if value == default:
            continue
        if not dimension:
            table[name] = _tables(value)
        elif value is None:
            table[f"{name}_{KEY_SUFFIXES[dimension][0]}"] = UNKNOWN
        else:
            unit, figures = _everyday(value, dimension)
            table[f"{name}_{unit}"] = figures
    return table


def _tables(value: Any) -> Any:
    if isinstance(value, FileModel | Record):
        return table_of(value)
    if isinstance(value, Mapping):
        return {name: _tables(member) for name, member in value.items() if member is not None}
    return [_tables(member) for member in value] if isinstance(value, list | tuple) else value


def _everyday(value: Any, dimension: str) -> tuple[str, Any]:
    """The unit and the value or values of an SI quantity: mm or degrees if these read back exactly, else SI."""
    values = value if isinstance(value, tuple) else (value,)
    unit, figures = KEY_SUFFIXES[dimension][0], [float(figure) for figure in values]
    everyday = {"length": "mm", "angle": "deg"}.get(dimension)
    if everyday:
        short = [_short(figure, everyday) for figure in values]
        if all(in_si(everyday, figure) == exact for figure, exact in zip(short, values, strict=True)):
            unit, figures = everyday, short
    return unit, figures if isinstance(value, tuple) else figures[0]


def _short(value: float, unit: str) -> float:
    """The number of fewest decimals that converts to an SI value exactly, or the nearest one if none does."""
    exact = float(value / to_si(unit)[0])
    shorter = (round(exact, digits) for digits in range(16))
    return next((figure for figure in shorter if in_si(unit, figure) == value), exact)
