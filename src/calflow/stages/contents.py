"""What a run folder holds, in words, from what the stages declare: the section of docs/files.md, and how to renew it.

python -m calflow.stages.contents docs/files.md
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from calflow.files.tables import Column, columns
from calflow.stages import STAGES

KINDS = {str: "text", int: "integer", float: "number", bool: "true or false"}
BEGIN, END = "<!-- tables: written from the code -->", "<!-- end of tables -->"


def contents() -> str:
    """Return every table and document of every stage with its columns, as Markdown."""
    return "\n\n".join(
        block for stage in STAGES.values() for block in (*_tables(stage.tables), *_tables(stage.documents))
    )


def renewed(text: str) -> str:
    """Return a document with what stands between the marks written anew."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n\n{contents()}\n\n{END}{tail}"


def _tables(declared: Mapping[str, type]) -> Iterator[str]:
    for path, row_type in declared.items():
        first = (row_type.__doc__ or "").strip().splitlines()[0]
        document = path.endswith(".json")
        what = "key" if document else "column"
        rows = "\n".join(_row(column, document) for column in columns(row_type))
        yield f"### {path}\n{first}\n\n| {what} | type | unit | meaning |\n| --- | --- | --- | --- |\n{rows}"


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


def main() -> None:
    """Renew a document in place."""
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
