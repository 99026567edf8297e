"""What a study may be signed with and what a run folder holds, in words, from the code: sections of docs/files.md, renewed.

python docs/made/contents.py docs/files.md
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

from pydantic.fields import FieldInfo

from calflow.deployment.comparison import Comparison
from calflow.deployment.compensation import Command
from calflow.deployment.drift import Drift
from calflow.deployment.export import ControllerFigure
from calflow.deployment.history import History
from calflow.deployment.validation import Validation
from calflow.design.cell import Box, Cell, CellStation, Cylinder
from calflow.design.next_poses import MeasuringVerdict, NextMeasurement
from calflow.files.deviations import Deviation
from calflow.files.tables import Column, columns
from calflow.files.toml import FileModel, Record
from calflow.stage_settings import SelectSettings, TaskSettings, WorkSettings
from calflow.stages.catalogue import STAGES
from calflow.study import Acceptance

KINDS = {str: "text", int: "integer", float: "number", bool: "true or false"}
ANSWERS: Mapping[str, type] = {  # the tables that commands other than run write
    "calflow compensate": Command,
    "calflow export --to controller": ControllerFigure,
    "calflow reproduce --out, differences.csv": Deviation,
}
FOLDERS: Mapping[str, Mapping[str, type]] = {
    "next": {"poses.csv": NextMeasurement, "verdict.json": MeasuringVerdict},
    "validate": Validation.tables(),
    "drift": Drift.tables(),
    "compare": Comparison.tables(),
    "history": History.tables(),
}  # what they keep in one
MARKS = "<!-- {}: written from the code -->", "<!-- end of {} -->"


def file_contents() -> str:
    """Return every table and document of every stage with its columns, and what commands answer, as Markdown."""
    kept = (block for stage in STAGES.values() for block in (*_tables(stage.tables), *_tables(stage.documents)))
    folders = (block for command, own in FOLDERS.items() for block in _tables(own, f"{command}/NAME/"))
    return "\n\n".join((*kept, *_tables(ANSWERS), *folders))


def renewed(text: str) -> str:
    """Return a document with what stands between the marks written anew."""
    kept = {
        "acceptance": keys("[acceptance]", Acceptance),
        "select": keys("[stages.select]", SelectSettings),
        "task": keys("[stages.select.task]", TaskSettings),
        "cell": keys("[stages.select.cell]", Cell),
        "stations": keys("[[stages.select.cell.stations]]", CellStation),
        "boxes": keys("[[stages.select.cell.boxes]]", Box),
        "cylinders": keys("[[stages.select.cell.cylinders]]", Cylinder),
        "work": keys("[stages.sample.task]", WorkSettings),
        "tables": file_contents(),
    }
    for name, written in kept.items():
        begin, end = (mark.format(name) for mark in MARKS)
        head, _, rest = text.partition(begin)
        _, _, tail = rest.partition(end)
        text = f"{head}{begin}\n\n{written}\n\n{end}{tail}"
    return text


def keys(table: str, settings: type[FileModel | Record]) -> str:
    """Return the keys of a table of a study, as Markdown."""
    stated = getattr(settings, "model_fields", None) or _fields(settings)
    rows = "\n".join(_key(name, field) for name, field in stated.items() if field.description)
    return f"| key of `{table}` | meaning |\n| --- | --- |\n{rows}"


def _fields(record: type[Record]) -> dict[str, FieldInfo]:
    """What is said of a record's fields, each with its default."""
    hints = get_type_hints(record, include_extras=True)
    return {
        field.name: FieldInfo.from_annotated_attribute(hints[field.name], field.default) for field in fields(record)
    }


def _key(name: str, field: FieldInfo) -> str:
    """A key, its meaning and its default; of a quantity, whose key carries a unit, the meaning tells both."""
    default = f" ({field.default})" if isinstance(field.default, int) else ""
    return f"| `{name}` | {field.description}{default} |"


def _tables(declared: Mapping[str, type], folder: str = "") -> Iterator[str]:
    for path, row_type in declared.items():
        first = (row_type.__doc__ or "").strip().splitlines()[0]
        document = path.endswith(".json")
        what = "key" if document else "column"
        rows = "\n".join(_row(column, document) for column in columns(row_type))
        yield f"### {folder}{path}\n{first}\n\n| {what} | type | unit | meaning |\n| --- | --- | --- | --- |\n{rows}"


def _row(column: Column, document: bool) -> str:
    name = column.name.replace("|", "\\|")
    return f"| `{name}` | {_type(column, document)} | {column.unit} | {column.meaning} |"


def _type(column: Column, document: bool) -> str:
    """Say a column's or a key's type."""
    if column.choices:
        return ", ".join(f"`{choice}`" for choice in column.choices)
    kind = KINDS.get(column.kind, "object")
    if column.many:
        return f"list of {kind}s" if document else f"{kind}s, `{column.separator.strip()}` between them"
    return f"{kind} or null" if document and column.gaps else kind


def _main() -> None:
    """Renew a document in place."""
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    _main()
