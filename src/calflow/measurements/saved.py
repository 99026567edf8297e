"""Measurements as a calibration saves them: a CSV file in SI units, and a JSON file with the metadata."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from calflow.files.deferred import pd
from calflow.files.tables import read_csv, read_texts, write_csv
from calflow.files.units import SUFFIXES
from calflow.files.writing import inside, write_text
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import column_names
from calflow.measurements.series import Series
from calflow.robot.robot import Robot

ROWS_FILE, BESIDE_FILE = "measurements.csv", "measurements.json"


@dataclass(frozen=True)
class Beside:
    """The metadata of saved measurements (see `Measurements`); types are the data types of the columns."""

    notes: tuple[str, ...]
    series: tuple[Series, ...]
    time_origin: float | None
    units: tuple[str, ...]
    types: dict[str, str]
    payload_stated: bool = True


def save_measurements(data: Measurements, folder: Path) -> None:
    """Write measurements into a folder without loss of precision."""
    table = data.table.rename(columns=_names_with_unit(data.robot))
    types = {str(name): str(kind) for name, kind in zip(table, table.dtypes, strict=True)}
    write_csv(inside(folder, ROWS_FILE), table, exact=True)
    beside = Beside(data.notes, data.series, data.time_origin, data.units, types, data.payload_stated)
    write_text(inside(folder, BESIDE_FILE), TypeAdapter(Beside).dump_json(beside, indent=2).decode() + "\n")


def load_measurements(folder: Path, robot: Robot) -> Measurements:
    """Return the measurements that `save_measurements` wrote into a folder."""
    beside = TypeAdapter(Beside).validate_json((folder / BESIDE_FILE).read_bytes())
    names = {spelled: name for name, spelled in _names_with_unit(robot).items()}
    figures, texts = read_csv(folder / ROWS_FILE), read_texts(folder / ROWS_FILE)
    plain = {name for name, kind in beside.types.items() if kind.startswith(("int", "float", "bool"))}
    cells = {name: figures[name] if name in plain else texts[name] for name in beside.types}
    table = pd.DataFrame({names.get(name, name): column for name, column in cells.items()})
    return Measurements(
        robot, table, beside.notes, beside.series, beside.time_origin, beside.units, beside.payload_stated
    )


def _names_with_unit(robot: Robot) -> dict[str, str]:
    """Return the names with SI unit, by the name without, of all columns that have a unit."""
    return {name: f"{name}_{SUFFIXES[kind][0]}" for name, kind in column_names(robot).items() if kind}
