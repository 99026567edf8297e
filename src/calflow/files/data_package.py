"""The data package: what a folder's files hold, for programs that do not know calflow (https://datapackage.org)."""

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
    """Describe files by their path in a folder: SHA-256 and bytes of each, and of a table every column.

    files has for each path in the folder where the file lies now, and its SHA-256; tables the row types of those that are tables.
    """
    resources = [_resource(name, *files[name], tables.get(name)) for name in sorted(files)]
    return {"$schema": PACKAGE_PROFILE, "title": title, "resources": resources}


def table_schema(names: Iterable[str], row_type: type) -> dict[str, Any]:
    """Return the Table Schema of a table with columns of these names: name, type, description and unit of each."""
    described = [_field(name, column) for name, column in declared_among(names, row_type).items()]
    return {"$schema": SCHEMA_PROFILE, "fields": described, "missingValues": [""]}


def _resource(name: str, path: Path, digest: str, row_type: type | None) -> dict[str, Any]:
    resource: dict[str, Any] = {"name": name.removesuffix(".csv").replace("/", "-").lower(), "path": name}
    resource |= {"bytes": path.stat().st_size, "hash": f"sha256:{digest}"}
    if row_type is None:  # some readers look into a JSON file of no stated type for a package
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
