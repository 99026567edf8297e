"""What a command keeps in a folder of its own: tables with their schemas, summaries, and a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calflow.files.csv import write_csv
from calflow.files.problems import refuse
from calflow.files.results import Results
from calflow.files.tables import schema
from calflow.files.writing import inside, write_text
from calflow.run_folder import NAME
from calflow.stages import STAGES

if TYPE_CHECKING:
    from calflow.reporting.blocks import Part


def write_results(folder: Path, results: Results, tables: Mapping[str, type]) -> None:
    """Write tables, each with its schema beside it, and documents; tables says of each what its rows are.

    Raises:
        InputError: a link leads out of the folder.
    """
    for name, table in results.tables.items():
        write_csv(inside(folder, name), table)
        described = json.dumps(schema(table, tables[name]), indent=2, ensure_ascii=False)
        write_text((folder / name).with_suffix(".schema.json"), f"{described}\n")
    for name, document in results.documents.items():
        said = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
        write_text(inside(folder, name), f"{said}\n")


def not_of_a_run(folder: Path) -> None:
    """Check that what a command keeps goes into a folder of its own.

    Raises:
        InputError: the folder is a run's own, or a stage's: their files would be written over.
    """
    if (folder / NAME).exists() or (folder.name in STAGES and (folder.parent / NAME).exists()):
        raise refuse(
            "holds what 'calflow run' made, which would be written over; give another folder with --out", folder
        )


def keep(
    folder: Path, results: Results, tables: Mapping[str, type], title: str, parts: Callable[[], Sequence[Part]]
) -> None:
    """Write results and their report.pdf with its figures; parts draws and words it.

    Raises:
        InputError: the folder is a run's own, or a stage's: their files would be written over.
    """
    from calflow.reporting.document import write_pdf
    from calflow.reporting.style import style

    not_of_a_run(folder)
    write_results(folder, results, tables)
    with style():
        write_pdf(title, parts(), folder)
