"""Data Package descriptors, which tell other programs what the files of a folder hold (https://datapackage.org)."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from calflow.files.tables import Column, Document, declared_among

DATA_PACKAGE = "datapackage.json"
PACKAGE_PROFILE = "https://datapackage.org/profiles/2.0/datapackage.json"
SCHEMA_PROFILE = "https://datapackage.org/profiles/2.0/tableschema.json"
FRICTIONLESS = {str: "string", int: "integer", float: "number", bool: "boolean"}  # types of a Table Schema


def data_package(title: str, files: Mapping[str, tuple[Path, str]], tables: Mapping[str, type]) -> Document:
    """Return the descriptor of a folder: the size and SHA-256 of each file, and the columns of each table.

    files maps each path in the folder to the file's location and SHA-256; tables maps those of tables to row types.
    """
    resources = [_resource(name, *files[name], tables.get(name)) for name in sorted(files)]
    return {"$schema": PACKAGE_PROFILE, "title": title, "resources": resources}


def table_schema(names: Iterable[str], row_type: type) -> dict[str, Any]:
    """Return the Table Schema of a table with the named columns: the name, type, description and unit of each."""
    described = [_field(name, column) for name, column in declared_among(names, row_type).items()]
    return {"$schema": SCHEMA_PROFILE, "fields": described, "missingValues": [""]}


def _resource(name: str, path: Path, digest: str, row_type: type | None) -> dict[str, Any]:
    resource: dict[str, Any] = {"name": name.removesuffix(".csv").replace("/", "-").lower(), "path": name}
    resource |= {"bytes": path.stat().st_size, "hash": f"sha256:{digest}"}
    if row_type is None:  # some readers take a JSON file without a stated type for a descriptor
        return resource | ({"type": "json"} if name.endswith(".json") else {})
    with path.open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    return resource | {
        "description": (row_type.__doc__ or "").strip().splitlines()[0],
        "type": "table", "format": "csv", "encoding": "utf-8", "schema": table_schema(header, row_type),
    }  # fmt: skip


def _field(name: str, column: Column) -> dict[str, Any]:
    kind = FRICTIONLESS[column.kind]
    field: dict[str, Any] = {"name": name, "type": "list" if column.many else kind, "description": column.meaning}
    if column.many:
        field |= {"delimiter": column.separator, "itemType": kind}
    if column.unit:
        field["unit"] = column.unit
    if column.choices:
        field["constraints"] = {"enum": list(column.choices)}
    return field
