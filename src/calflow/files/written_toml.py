"""TOML as calflow writes it: records in everyday units, without what is the default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import tomli_w

from calflow.files.toml import UNKNOWN, FileModel, Record, dimensions
from calflow.files.units import KEY_SUFFIXES, in_si, to_si
from calflow.files.writing import write_text


def write_toml(path: Path, file: FileModel) -> None:
    """Write a file that `read_toml` reads back equal: all that is not as it is by default."""
    write_text(path, tomli_w.dumps(table_of(file)))


def table_of(record: FileModel | Record, **other: str) -> dict[str, Any]:
    """Return the table that states a record: without what is so where nothing is stated, and in units that people use.

    A unit is one in which the figure reads back the same, else that of SI. other gives dimensions of fields of several.
    """
    table: dict[str, Any] = {}
    for name, default in _defaults(type(record)).items():
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


def _defaults(kind: type[FileModel | Record]) -> dict[str, Any]:
    if issubclass(kind, FileModel):
        return {name: field.get_default(call_default_factory=True) for name, field in kind.model_fields.items()}
    return {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(kind)
    }


def _tables(value: Any) -> Any:
    if isinstance(value, FileModel | Record):
        return table_of(value)
    if isinstance(value, Mapping):
        return {name: _tables(member) for name, member in value.items() if member is not None}
    return [_tables(member) for member in value] if isinstance(value, list | tuple) else value


def _everyday(value: Any, dimension: str) -> tuple[str, Any]:
    """An SI value, or several, in mm or degrees where the figures read back the same; else in the SI unit."""
    values = value if isinstance(value, tuple) else (value,)
    unit, figures = KEY_SUFFIXES[dimension][0], [float(figure) for figure in values]
    everyday = {"length": "mm", "angle": "deg"}.get(dimension)
    if everyday:
        short = [_short(figure, everyday) for figure in values]
        if all(in_si(everyday, figure) == exact for figure, exact in zip(short, values, strict=True)):
            unit, figures = everyday, short
    return unit, figures if isinstance(value, tuple) else figures[0]


def _short(value: float, unit: str) -> float:
    """The figure of fewest decimals that means an SI value in a unit, as near as there is."""
    exact = float(value / to_si(unit)[0])
    shorter = (round(exact, digits) for digits in range(16))
    return next((figure for figure in shorter if in_si(unit, figure) == value), exact)
