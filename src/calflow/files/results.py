"""Results: the tables and documents that stages made, by their path in the run folder.

Documents: what a run keeps as JSON, each declared once as a dataclass whose fields are `tables.column`s.

None stands for what cannot be told. Keys carry their unit, as columns do.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import pandas as pd
from pydantic import ValidationError

from calflow.files.problems import InputError, refuse
from calflow.files.tables import Tables, from_frame, to_frame, write_csv
from calflow.files.toml import adapter
from calflow.files.writing import inside, write_text

Document = Mapping[str, Any]
Documents = Mapping[str, Document]

EXACT = ("identify", "diagnose", "residual_field")  # the stages whose results are a calibration
SUM = "sha256"  # the key of the sum of all the others, by which a turned bit is noticed


def to_document(value: Any) -> Document:
    """Return a dataclass as JSON's values; a number that is not finite becomes None."""
    return {name: _plain(item) for name, item in asdict(value).items()}


def from_document(document: Document, kind: type[Kind]) -> Kind:
    """Return a document as its dataclass; what the dataclass does not know is left out.

    Raises:
        InputError: a value is missing or of another type.
    """
    try:
        made: Kind = adapter(kind).validate_python(dict(document))
        return made
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, error['loc']))}: {error['msg']}" for error in error.errors())
        raise refuse(f"a summary of calflow was changed ({wrong}); run the study again") from None


def document_text(document: Document) -> str:
    """Return a document as it is written."""
    return f"{json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def sealed(document: Document) -> Document:
    """Return a document with a sum of itself."""
    return {**document, SUM: _sum(document)}


def is_whole(document: Document) -> bool:
    """Return whether a document is as it was sealed; one without a sum is of an earlier version, and counts as whole."""
    content = {name: value for name, value in document.items() if name != SUM}
    return SUM not in document or document[SUM] == _sum(content)


def _sum(document: Document) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item"):  # of NumPy
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Results:
    """Tables (CSV) and documents (JSON) by their path in the run folder, e.g. `identify/accuracy.csv`."""

    tables: Tables = field(default_factory=dict, repr=False)
    documents: Documents = field(default_factory=dict, repr=False)

    def __contains__(self, path: str) -> bool:
        """Whether a table or document is there."""
        return path in self.tables or path in self.documents

    def __or__(self, other: Results) -> Results:
        """Return these results and others, whose tables and documents count where both have one."""
        return Results({**self.tables, **other.tables}, {**self.documents, **other.documents})

    def of(self, stages: set[str]) -> Results:
        """Return what these stages made."""
        return Results(_of(self.tables, stages), _of(self.documents, stages))

    def rows(self, path: str, row_type: type[Kind]) -> list[Kind]:
        """Return a table's rows as values.

        Raises:
            InputError: another version, which did not have the table or a column of it, made the results.
        """
        if path not in self.tables:
            raise _lacking(path)
        return from_frame(self.tables[path], row_type, path)

    def document(self, path: str, kind: type[Kind]) -> Kind:
        """Return a document as its dataclass.

        Raises:
            InputError: as of a table.
        """
        if path not in self.documents:
            raise _lacking(path)
        return from_document(self.documents[path], kind)


@dataclass(frozen=True)
class Tabled:
    """Base of what was found, kept as a file a field: rows as NAME.csv, a summary as NAME.json; other fields are in none."""

    @classmethod
    def tables(cls) -> dict[str, type]:
        """Return what its files' rows are, by their name."""
        rows: dict[str, type] = {}
        for name, hint in get_type_hints(cls).items():
            row = get_args(hint)[0] if get_origin(hint) is tuple else hint
            if any("column" in field.metadata for field in getattr(row, "__dataclass_fields__", {}).values()):
                rows[f"{name}.{'json' if row is hint else 'csv'}"] = row
        return rows

    @property
    def results(self) -> Results:
        """Its tables and summary by their file's name."""
        made = {name: (getattr(self, name.partition(".")[0]), row) for name, row in self.tables().items()}
        return Results(
            {name: to_frame(content, row) for name, (content, row) in made.items() if name.endswith(".csv")},
            {name: to_document(content) for name, (content, _) in made.items() if name.endswith(".json")},
        )


def write_results(folder: Path, results: Results) -> None:
    """Write tables and documents; what a calibration is read back from is read back to the last bit.

    Raises:
        InputError: a link leads out of the folder.
    """
    for name, table in results.tables.items():
        write_csv(inside(folder, name), table, exact=name.partition("/")[0] in EXACT)
    for name, document in results.documents.items():
        write_text(inside(folder, name), document_text(document))


Made = TypeVar("Made", pd.DataFrame, Document)


def _lacking(path: str) -> InputError:
    return refuse(f"has no {path}: an earlier version of calflow made these results; run the study again")


def _of(made: Mapping[str, Made], stages: set[str]) -> dict[str, Made]:
    return {path: content for path, content in made.items() if path.partition("/")[0] in stages}
