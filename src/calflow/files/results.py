"""Results: the tables and documents that stages made, by their path in the run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import pandas as pd

from calflow.files.documents import Document, Documents, from_document
from calflow.files.problems import InputError, refuse
from calflow.files.tables import Tables, from_frame

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


Made = TypeVar("Made", pd.DataFrame, Document)


def _lacking(path: str) -> InputError:
    return refuse(f"has no {path}: an earlier version of calflow made these results; run the study again")


def _of(made: Mapping[str, Made], stages: set[str]) -> dict[str, Made]:
    return {path: one for path, one in made.items() if path.partition("/")[0] in stages}
