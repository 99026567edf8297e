"""Output folders of commands: tables and summaries with the data package that describes them, and a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calflow.files.data_package import DATA_PACKAGE, data_package
from calflow.files.problems import refuse
from calflow.files.tables import Document, Results, StoredResults, write_results
from calflow.measurements.source import sha256
from calflow.run_folder import NAME
from calflow.stages.catalogue import STAGES

if TYPE_CHECKING:
    from calflow.reporting.blocks import Part


def keep_results(folder: Path, results: Results, tables: Mapping[str, type], title: str) -> None:
    """Write results and their data package; tables are the row types of the tables.

    Raises:
        InputError: the folder belongs to a run or a stage, whose files would be overwritten, or a link leads out of it.
    """
    if (folder / NAME).exists() or (folder.name in STAGES and (folder.parent / NAME).exists()):
        message = "holds what 'calflow run' made, which would be written over; give another folder with --out"
        raise refuse(message, folder)
    write_results(folder, results)
    files = {name: (folder / name, sha256(folder / name)) for name in (*results.tables, *results.documents)}
    write_results(folder, Results(documents={DATA_PACKAGE: data_package(title, files, tables)}))


def run_package(study: str, files: Mapping[str, tuple[Path, str]]) -> Document:
    """Return a run's data package; files are those of `data_package`, of which some may be missing."""
    tables = {name: row_type for stage in STAGES.values() for name, row_type in stage.tables.items()}
    there = {name: (path, digest) for name, (path, digest) in files.items() if path.is_file()}
    return data_package(study, there, tables)


def keep(folder: Path, result: StoredResults, title: str, parts: Callable[[], Sequence[Part]]) -> None:
    """Write a result and its report.pdf with figures; parts returns the content of the report.

    Raises:
        InputError: see `keep_results`.
    """
    from calflow.reporting.document import write_pdf
    from calflow.reporting.style import style

    keep_results(folder, result.results, result.tables(), title)
    with style():
        write_pdf(title, parts(), folder)
