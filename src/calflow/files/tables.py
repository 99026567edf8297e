"""Tables that a run stores as CSV, each declared once by the dataclass of its rows, and their writing and reading.

    @dataclass(frozen=True, kw_only=True)
    class Correlation:
        "A strongly correlated pair of parameters."
        first: str = column("a parameter")
        correlation: float = column("of the estimates, -1 to 1")

The type of a field is that of its column: `str`, `int`, `float`, `bool`, a `Literal` of texts, `T | None` where cells
may be empty, `tuple[T, ...]` for a list in a cell. `Mapping[str, T]` holds all columns of a pattern: `q{joint}_{deg|mm}`.

A text that a spreadsheet would evaluate, such as `=1+1`, is written with a leading apostrophe, which marks it as text;
so is one that already begins with apostrophes. Numbers, and lists of numbers in a cell, are written unchanged.

Documents are stored as JSON, each declared once by a dataclass of `column`s; None stands for an unknown value.
Results are the tables and documents by their path in the run folder.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from functools import cache, cached_property, partial
from importlib.metadata import version
from pathlib import Path
from types import NoneType, UnionType
from typing import IO, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import ValidationError

from calflow.files.deferred import pd
from calflow.files.problems import InputError, refuse
from calflow.files.toml import adapter
from calflow.files.writing import inside, write_text

FLOATS = "%.10g"  # more digits than any measurement supports, fewer than rounding errors affect
# pandas before 3.1 may misread the last bit of a number without this option; later versions warn about it.
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if version("pandas").split(".")[:2] < ["3", "1"] else {}

# The beginning of a text that a spreadsheet would evaluate, or that would be taken for a quoted one.
_COMPUTED = re.compile(r"'*[=+\-@\t\r]")
NUMBER = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"
_NUMBERS = re.compile(rf"'*{NUMBER}(\s*;\s*{NUMBER})*")
Tables: TypeAlias = "Mapping[str, pd.DataFrame]"
Row = TypeVar("Row")
CALIBRATIONS = ("identify", "diagnose", "residual_field")  # stages from whose results a calibration is read back
SUM = "sha256"  # the key of the checksum of all other keys


def csv_text(table: pd.DataFrame, exact: bool = False, *, separator: str = ",", decimal: str = ".") -> str:
    """Return a table as CSV text; exact: with as many digits as its numbers need to be read back to the last bit."""
    floats = None if exact else FLOATS
    quoted = _changed(table, lambda text: f"'{text}" if _is_computed(text) else text)
    return str(quoted.to_csv(index=False, sep=separator, decimal=decimal, float_format=floats, lineterminator="\n"))


def write_csv(path: Path, table: pd.DataFrame, exact: bool = False) -> None:
    """Write a table atomically; exact: such that its numbers are read back to the last bit."""
    write_text(path, csv_text(table, exact))


def read_csv(source: Path | IO[bytes]) -> pd.DataFrame:
    """Return a table that `write_csv` wrote, with its numbers to the last bit and one type per column."""
    return _changed(pd.read_csv(source, low_memory=False, **EXACT), unquoted)


def read_texts(path: Path) -> pd.DataFrame:
    """Return a table that `write_csv` wrote, with every cell as unconverted text."""
    return _changed(pd.read_csv(path, dtype=str, keep_default_na=False), unquoted)


def unquoted(text: str) -> str:
    """Return the text of a cell without the apostrophe that keeps spreadsheets from evaluating it."""
    return text[1:] if text.startswith("'") and _is_computed(text) else text


def changed(cells: pd.Series, change: Callable[[str], str]) -> pd.Series:
    """Return cells with a function applied to every text, once per distinct text."""
    texts = [text for text in cells.unique() if isinstance(text, str)]
    others = {text: other for text in texts if (other := change(text)) != text}
    return cells.map(lambda cell: others.get(cell, cell)) if others else cells


def _changed(table: pd.DataFrame, change: Callable[[str], str]) -> pd.DataFrame:
    """A table with a function applied to every text, including the names of columns."""
    table = table.rename(columns=lambda name: change(name) if isinstance(name, str) else name)
    for k, kind in enumerate(table.dtypes):
        if not pd.api.types.is_numeric_dtype(kind):
            cells = table.iloc[:, k]
            if (others := changed(cells, change)) is not cells:
                table.isetitem(k, others.array)
    return table


def _is_computed(text: str) -> bool:
    return bool(_COMPUTED.match(text)) and not _NUMBERS.fullmatch(text)


@dataclass(frozen=True)
class Column:
    """The declaration of a column, or of a pattern of columns with braces in its name: field, type, unit and meaning.

    many: a cell holds a list, with separator between items; gaps: a cell may be empty; choices: the permitted texts;
    sd: the column that holds the standard deviations of the values.
    """

    field: str
    name: str
    kind: type
    meaning: str
    unit: str
    many: bool
    gaps: bool
    separator: str
    choices: tuple[str, ...]
    sd: str = ""

    @property
    def is_pattern(self) -> bool:
        """Whether the name is a pattern, which any number of columns may match."""
        return "{" in self.name

    def matches(self, name: str) -> bool:
        """Whether a name matches the column or pattern: `{a|b}` matches a or b, `{word}` any text."""
        return re.fullmatch(_expression(self.name), name) is not None


def column(
    meaning: str, unit: str = "", *, name: str = "", separator: str = ";", sd: str = "", default: Any = MISSING
) -> Any:
    """Return a dataclass field that declares a column of a table.

    Args:
        meaning: short description of its values.
        unit: unit of its values, if any.
        name: name or pattern of the column, if it differs from the field's name.
        separator: text between the items of a list.
        sd: column that holds the standard deviations of its values.
        default: value for rows that are built without one.
    """
    declared = {"meaning": meaning, "unit": unit, "name": name, "separator": separator, "sd": sd}
    return field(default=default, metadata={"column": declared})


def _columns(row_type: type) -> tuple[Column, ...]:
    """The columns that the dataclass of a row declares, in order."""
    hints = get_type_hints(row_type)
    return tuple(_column(of.name, hints[of.name], of.metadata["column"]) for of in fields(row_type))


columns: Callable[[type], tuple[Column, ...]] = cache(_columns)


def _column(name: str, hint: Any, metadata: Mapping[str, str]) -> Column:
    kind, many, gaps, choices = _kind(hint)
    return Column(name, metadata["name"] or name, kind, metadata["meaning"], metadata["unit"], many, gaps,
                  metadata["separator"], choices, metadata["sd"])  # fmt: skip


def to_frame(rows: Iterable[Row], row_type: type[Row]) -> pd.DataFrame:
    """Return rows as a table whose columns, also of an empty table, have the declared order and types."""
    rows = list(rows)
    made: dict[str, list[Any]] = {}
    for column in columns(row_type):
        values = [getattr(row, column.field) for row in rows]
        if column.is_pattern:
            made |= {name: [value[name] for value in values] for name in dict.fromkeys(n for v in values for n in v)}
        else:
            made[column.name] = values
    return typed(pd.DataFrame(made, dtype=object), row_type)


def typed(frame: pd.DataFrame, row_type: type) -> pd.DataFrame:
    """Return a table with its columns in the order and of the types that its row type declares.

    Raises:
        TypeError: a declared column is missing, or one is not declared.
    """
    declared = declared_among(frame.columns, row_type)
    missing, extra = _missing(declared, row_type), set(frame) - set(declared)
    if missing or extra:
        raise TypeError(f"{row_type.__name__}: missing {missing}, not declared {sorted(map(str, extra))}")
    return pd.DataFrame({name: _stored(frame[name], column) for name, column in declared.items()}, index=frame.index)


def from_frame(frame: pd.DataFrame, row_type: type[Row], name: str = "a table of calflow") -> list[Row]:
    """Return the rows of a table as dataclasses; an empty cell becomes None if gaps are declared, else nan or "".

    name is the table's name in error messages.

    Raises:
        InputError: a column is missing, or a value is not of its declared type.
    """
    declared = declared_among(frame.columns, row_type)
    if missing := _missing(declared, row_type):
        raise refuse(f"{name} lacks columns: {', '.join(missing)}; run the study again")
    try:
        cells = {name: [_value(cell, column) for cell in frame[name]] for name, column in declared.items()}
        single = {column.field: cells[name] for name, column in declared.items() if not column.is_pattern}
        several = [column for column in columns(row_type) if column.is_pattern]
        rows = []
        for k in range(len(frame)):
            values: dict[str, Any] = {name: cells_of[k] for name, cells_of in single.items()}
            for pattern in several:
                values[pattern.field] = {name: cells[name][k] for name, column in declared.items() if column is pattern}
            rows.append(row_type(**values))
    except (TypeError, ValueError) as error:
        raise refuse(f"{name} was changed: {error}; run the study again") from None
    return rows


@dataclass(frozen=True, eq=False, repr=False)
class TypedTable(Sequence[Row]):
    """The rows of a table as a sequence of dataclasses; `table` is the DataFrame, name its name in error messages."""

    table: pd.DataFrame
    row_type: type[Row]
    name: str = "a table of calflow"

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        return tuple(from_frame(self.table, self.row_type, self.name))

    def __getitem__(self, k: Any) -> Any:
        return self._rows[k]

    def __len__(self) -> int:
        return len(self.table)

    def __repr__(self) -> str:
        return repr(self.table) if len(self) else f"no {self.row_type.__name__}"

    def _repr_html_(self) -> str:
        return str(self.table.to_html(index=False))


def as_declared(frame: pd.DataFrame, row_type: type) -> pd.DataFrame:
    """Return a table that was read from CSV with its columns converted to their declared types.

    Empty texts become "", lists stay text, and integers and truth values with gaps become nullable types of pandas.
    """

    def text(cell: Any, many: bool) -> Any:
        return "" if pd.isna(cell) else _text(cell) if many or isinstance(cell, float) else cell

    columns = {}
    for name, column in declared_among(map(str, frame), row_type).items():
        if column.many or column.kind is str:
            columns[name] = frame[name].map(partial(text, many=column.many))
        elif column.gaps and column.kind is not float:
            columns[name] = _stored(frame[name], column)
    return frame.assign(**columns)


def missing_columns(frame: pd.DataFrame, row_type: type) -> list[str]:
    """Return the names of the declared columns that a table lacks."""
    return _missing(declared_among(frame.columns, row_type), row_type)


def declared_among(names: Iterable[str], row_type: type) -> dict[str, Column]:
    """Return the declared columns that occur among the names, by name and in the order of declaration."""
    declared, there = columns(row_type), [str(name) for name in names]
    fixed = {column.name for column in declared}
    matched: dict[str, Column] = {}
    for column in declared:
        if column.is_pattern:
            matched |= {name: column for name in there if name not in fixed | set(matched) and column.matches(name)}
        elif column.name in there:
            matched[column.name] = column
    return matched


def _missing(declared: Mapping[str, Column], row_type: type) -> list[str]:
    return [column.name for column in columns(row_type) if not column.is_pattern and column.name not in declared]


@cache
def _expression(pattern: str) -> str:
    pieces = re.split(r"(\{[^}]*\})", pattern)
    return "".join(
        (f"(?:{piece[1:-1]})" if "|" in piece else ".+") if piece.startswith("{") else re.escape(piece)
        for piece in pieces
    )


def _kind(hint: Any) -> tuple[type, bool, bool, tuple[str, ...]]:
    """The type of an item, whether a cell holds a list, whether it may be empty, and the permitted texts."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        (hint,) = (hint for hint in inner if hint is not NoneType)
        kind, many, _, choices = _kind(hint)
        return kind, many, True, choices
    if origin is tuple:
        return inner[0], True, False, ()
    if origin is dict:
        return dict, False, False, ()
    if origin is Literal:
        return str, False, False, inner
    return (_kind(inner[1])[0] if inner else hint), False, False, ()


def _stored(cells: pd.Series, column: Column) -> pd.Series:
    if column.many:
        return cells.map(lambda items: column.separator.join(map(_item, items))).astype(object)
    if column.kind is str:
        return cells.astype(object).where(cells.notna(), "")
    if column.kind is float:
        return cells.astype(float)
    if column.gaps:
        return cells.astype("boolean" if column.kind is bool else "Int64")
    return cells.astype(column.kind)


def _item(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _value(cell: Any, column: Column) -> Any:
    empty = bool(pd.isna(cell)) or cell == ""
    if column.many:
        items: Sequence[str] = [] if empty else _text(cell).split(column.separator)
        return tuple(column.kind(item.strip()) for item in items)
    if empty and column.gaps:
        return None
    if column.kind is str:
        return "" if empty else _text(cell)
    if column.kind is bool and isinstance(cell, str):
        return {"True": True, "False": False}[cell]
    return float("nan") if empty and column.kind is float else column.kind(cell)


def _text(cell: Any) -> str:
    """A cell as text, where pandas may have read integers with gaps as floats."""
    return f"{cell:.0f}" if isinstance(cell, float) and cell.is_integer() else str(cell)


Document = Mapping[str, Any]
Documents = Mapping[str, Document]


def to_document(value: Any) -> Document:
    """Return a dataclass as a JSON document; numbers that are not finite become None."""
    return {name: _plain(item) for name, item in asdict(value).items()}


def from_document(document: Document, kind: type[Kind]) -> Kind:
    """Return a document as its dataclass; unknown keys are ignored.

    Raises:
        InputError: a value is missing or of the wrong type.
    """
    try:
        made: Kind = adapter(kind).validate_python(dict(document))
        return made
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, error['loc']))}: {error['msg']}" for error in error.errors())
        raise refuse(f"a summary of calflow was changed ({wrong}); run the study again") from None


def document_text(document: Document) -> str:
    """Return a document as JSON text."""
    return f"{json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def with_checksum(document: Document) -> Document:
    """Return a document with its SHA-256 checksum added."""
    return {**document, SUM: _sum(document)}


def checksum_matches(document: Document) -> bool:
    """Whether a document agrees with its checksum; a document without one, of an earlier version, counts as intact."""
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


@dataclass(frozen=True, eq=False)
class DeferredTables(Mapping[str, "pd.DataFrame"]):
    """Tables by path, each made when it is first asked for: most commands ask for few of the dozens of a run."""

    paths: tuple[str, ...]
    make: Callable[[str], pd.DataFrame]
    made: dict[str, pd.DataFrame] = field(default_factory=dict, repr=False)

    def __getitem__(self, path: str) -> pd.DataFrame:
        if path not in self.made:
            if path not in self.paths:
                raise KeyError(path)
            self.made[path] = self.make(path)
        return self.made[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self.paths)

    def __len__(self) -> int:
        return len(self.paths)


@dataclass(frozen=True)
class Results:
    """Tables (CSV) and documents (JSON) by their path in the run folder, such as `identify/accuracy.csv`."""

    tables: Tables = field(default_factory=dict, repr=False)
    documents: Documents = field(default_factory=dict, repr=False)

    def __contains__(self, path: str) -> bool:
        """Whether there is a table or document of this path."""
        return path in self.tables or path in self.documents

    def __or__(self, other: Results) -> Results:
        """Return the union of two results; where both have a path, the other's content is taken."""
        paths = tuple(dict.fromkeys((*self.tables, *other.tables)))
        tables = DeferredTables(paths, lambda path: (other if path in other.tables else self).tables[path])
        return Results(tables, {**self.documents, **other.documents})

    def of(self, stages: set[str]) -> Results:
        """Return the results of the given stages."""
        documents = {path: self.documents[path] for path in _of(self.documents, stages)}
        return Results(DeferredTables(_of(self.tables, stages), self.tables.__getitem__), documents)

    def rows(self, path: str, row_type: type[Kind]) -> list[Kind]:
        """Return the rows of a table as dataclasses.

        Raises:
            InputError: the table or a column is missing, as in results of another version.
        """
        if path not in self.tables:
            raise _lacking(path)
        return from_frame(self.tables[path], row_type, path)

    def document(self, path: str, kind: type[Kind]) -> Kind:
        """Return a document as its dataclass.

        Raises:
            InputError: the document or a value is missing, as in results of another version.
        """
        if path not in self.documents:
            raise _lacking(path)
        return from_document(self.documents[path], kind)


@dataclass(frozen=True)
class StoredResults:
    """Base of results with a file per field: rows in NAME.csv, a summary in NAME.json; other fields are not stored."""

    @classmethod
    def tables(cls) -> dict[str, type]:
        """Return the row type, or the type of the summary, of each file by its name."""
        rows: dict[str, type] = {}
        for name, hint in get_type_hints(cls).items():
            row = get_args(hint)[0] if get_origin(hint) is tuple else hint
            if any("column" in field.metadata for field in getattr(row, "__dataclass_fields__", {}).values()):
                rows[f"{name}.{'json' if row is hint else 'csv'}"] = row
        return rows

    @property
    def results(self) -> Results:
        """The tables and summaries by file name."""
        made = {name: (getattr(self, name.partition(".")[0]), row) for name, row in self.tables().items()}
        return Results(
            {name: to_frame(content, row) for name, (content, row) in made.items() if name.endswith(".csv")},
            {name: to_document(content) for name, (content, _) in made.items() if name.endswith(".json")},
        )


def write_results(folder: Path, results: Results) -> None:
    """Write tables and documents; those from which a calibration is read back are exact to the last bit.

    Raises:
        InputError: a link leads out of the folder.
    """
    for name, table in results.tables.items():
        write_csv(inside(folder, name), table, exact=name.partition("/")[0] in CALIBRATIONS)
    for name, document in results.documents.items():
        write_text(inside(folder, name), document_text(document))


def _lacking(path: str) -> InputError:
    return refuse(f"has no {path}: an earlier version of calflow made these results; run the study again")


def _of(paths: Iterable[str], stages: set[str]) -> tuple[str, ...]:
    return tuple(path for path in paths if path.partition("/")[0] in stages)
