"""Foreign tables: the tables in a text file or workbook whose format is not stated.

Encoding, separator, decimal sign, preceding lines, a separate line of units and trailing lines are inferred from the
content; every inference is recorded as a reason.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path

import numpy as np

from calflow.files.deferred import pd
from calflow.files.problems import refuse, regular_file, truncated
from calflow.measurements.cells import OLE, REMEDY, WORKBOOKS, Dialect, csv_lines, read_text_of, sheets_of

SEPARATORS = (";", "\t", ",", "|", " ")
ENCODINGS = ("utf-8", "cp1252", "latin-1")  # in the order in which they are tried
MOST_LOOKED_AT = 20_000  # cells from which the decimal sign is inferred
SAMPLE = 100_000  # characters of a text from which the separator is inferred
FEWEST_FIGURES = 3  # least number of numeric columns of a table
UNIT = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "°": "deg", "º": "deg", "rad": "rad", "radian": "rad",
    "radians": "rad", "mrad": "mrad", "mm": "mm", "millimeter": "mm", "millimetre": "mm", "m": "m", "meter": "m", "metre": "m",
    "um": "um", "µm": "um", "μm": "um", "micron": "um", "microns": "um", "cm": "cm", "in": "in", "inch": "in", "inches": "in",
    "s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns", "min": "min",
    "°c": "degC", "degc": "degC", "celsius": "degC", "k": "K",
}  # fmt: skip
TIMES = {"time", "t", "timestamp", "zeit", "stamp", "zeitstempel", "datetime", "date", "uhrzeit", "clock"}
TEMPERATURES = {"temp", "temperature", "temperatur"}
# Words of which a name must contain one for its last word to be this unit: `z_min` is a minimum, `pose_k` the k-th.
QUANTITIES = {"min": TIMES, "s": TIMES, "k": {*TEMPERATURES, "t"}}
_BRACKETED = re.compile(r"[\[({<]\s*([^\])}>]+?)\s*[\])}>]")
_FIGURE = re.compile(r"[+\-−]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_THOUSANDS = {".": re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?"), ",": re.compile(r"[+-]?\d{1,3}(\.\d{3})+(,\d+)?")}


@dataclass(frozen=True)
class ForeignColumn:
    """A column of a foreign table: name without unit, unit if stated, cells as text, and numbers (nan where none)."""

    name: str
    unit: str
    cells: pd.Series
    figures: np.ndarray

    @property
    def is_figures(self) -> bool:
        """Whether more than 90 % of the cells that are not empty are numbers."""
        filled = (self.cells != "").to_numpy()
        return bool(filled.any()) and np.isfinite(self.figures[filled]).mean() > 0.9

    @property
    def title(self) -> str:
        """The name with the unit in brackets."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class ForeignTable:
    """A table of a file; part names the sheet or topic that holds it, and reasons say how it was read.

    named says whether the file names its columns.
    """

    path: Path
    part: str
    columns: tuple[ForeignColumn, ...]
    named: bool
    reasons: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.columns[0].figures)

    @property
    def title(self) -> str:
        """The name of the file, followed by that of the part."""
        return f"{self.path.name}{f', {self.part}' if self.part else ''}"


def foreign_tables(path: Path) -> list[ForeignTable]:
    """Return the tables of a text file or workbook.

    Raises:
        InputError: there is no table, or its format cannot be inferred.
    """
    regular_file(path)
    if path.suffix.lower() in WORKBOOKS:
        found = [_table(path, f"sheet '{name}'", rows, ()) for name, rows in sheets_of(path).items()]
        tables = [table for table in found if table]
        if not tables:
            raise refuse(f"has no sheet with {FEWEST_FIGURES} columns of figures", path)
        return tables
    return [_of_text(path)]


def _of_text(path: Path) -> ForeignTable:
    content = path.read_bytes()
    if path.suffix.lower() == ".mat":
        raise refuse(
            "is a MATLAB file: name its arrays' columns in the study's [measurements.columns], as array_1, array_2 …",
            path,
        )
    if content.startswith(OLE):
        raise refuse(f"is an Excel file from before 2007: save it as .xlsx, or {REMEDY}", path)
    encoding = _encoding(content)
    text = read_text_of(path, Dialect(separator="\t", encoding=encoding))
    written = () if encoding == "utf-8" else (f"written in {encoding}",)
    begins = text[:SAMPLE]
    tables = [
        (sum(column.is_figures for column in table.columns) * len(table), -k)
        for k, separator in enumerate(SEPARATORS)
        if (table := _separated(path, begins, separator, ()))
    ]
    if not tables:
        raise refuse(
            f"no table is found in it: expected lines of at least {FEWEST_FIGURES} figures, between one of ; , | tabs or blanks",
            path,
        )
    separator = SEPARATORS[-max(tables)[1]]
    separator_words = {"\t": "tabs", " ": "blanks"}.get(separator, f"'{separator}'")
    table = _separated(path, text, separator, (f"columns separated by {separator_words}", *written))
    if table is None:
        raise refuse("its lines differ in form: perhaps a quote is opened and not closed", path)
    return table


def _separated(path: Path, text: str, separator: str, reasons: tuple[str, ...]) -> ForeignTable | None:
    """The table of a text with a given separator; None if it has none."""
    try:
        return _table(path, "", list(csv_lines(text, separator)), reasons)
    except csv.Error:
        return None


def _encoding(content: bytes) -> str:
    """The encoding of a text, by its first bytes, else the first encoding that decodes all of it."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if content[1:200:2].count(0) > 40:
        return "utf-16-le"

    def decodes(encoding: str) -> bool:
        try:
            content.decode(encoding)
        except UnicodeDecodeError:
            return False
        return True

    return next(filter(decodes, ENCODINGS))


def _table(path: Path, part: str, rows: Sequence[Sequence[str]], reasons: tuple[str, ...]) -> ForeignTable | None:
    """The table in rows of cells, or None: the lines with about the usual number of numbers, and the header above."""
    cells = [[cell.strip().removeprefix("'") for cell in row] for row in rows]
    wide = max(map(len, cells), default=0)
    cells = [row + [""] * (wide - len(row)) for row in cells]
    counts = np.array([sum(map(_is_figure, row)) for row in cells])
    usual = Counter(int(count) for count in counts if count >= FEWEST_FIGURES).most_common(1)
    if not usual:
        return None
    of_figures = counts >= max(FEWEST_FIGURES, usual[0][0] / 2)
    first = int(np.argmax(of_figures))
    body = [k for k in range(first, len(cells)) if of_figures[k]]
    left = [k + 1 for k in range(first, len(cells)) if not of_figures[k] and any(cells[k])]
    used = [k for k in range(wide) if any(cells[line][k] for line in body)]
    names, header = _names(cells, first, used)
    texts = {k: [cells[line][k] for line in body] for k in used}
    decimal = _decimal([cell for column in texts.values() for cell in column])
    columns = tuple(_column(name, texts[k], decimal) for name, k in zip(names, used, strict=True))
    how = ["no line of names" if header is None else f"names in line {header + 1}"]
    if decimal == ",":
        how.append("decimal commas")
    if left:
        how.append(f"{len(left)} lines without figures left out (line {left[0]}{' …' if len(left) > 1 else ''})")
    return ForeignTable(path, part, columns, header is not None, (*reasons, *how))


def _is_figure(cell: str) -> bool:
    """Whether a cell holds a number, with or without a unit after it."""
    try:
        float(cell)
        return "_" not in cell
    except ValueError:
        return bool(_FIGURE.fullmatch(_bare(cell)))


def _names(cells: Sequence[Sequence[str]], first: int, used: Sequence[int]) -> tuple[list[str], int | None]:
    """The names of columns, with units of a separate line and headings that span columns, and their line's index."""
    above = list(takewhile(lambda k: any(cells[k]), range(first - 1, -1, -1)))
    headers = [[cells[k][column] for column in used] for k in above]
    if headers:
        headers[0] = _uncommented(headers[0], cells[above[0]])
    full = [sum(map(bool, row)) >= 0.6 * len(used) for row in headers]
    if not any(full[:2]):
        return [f"column {k + 1}" for k in used], None
    units, at = [""] * len(used), full.index(True)
    if _all_units(headers[at]) and any(full[at + 1 : at + 2]):
        units, at = headers[at], at + 1
    names = [truncated(name) for name in headers[at]]
    stated = [*filter(None, names)]
    if at + 1 < len(headers) and len(set(stated)) < len(stated):
        over = pd.Series([cell or None for cell in headers[at + 1]], dtype=object).ffill().fillna("")
        names = [f"{group} {name}".strip() for group, name in zip(over, names, strict=True)]
    names = [
        f"{name} [{unit.strip('[]() ')}]" if unit.strip("[]() -1") else name
        for name, unit in zip(names, units, strict=True)
    ]
    names = [name or f"column {k + 1}" for name, k in zip(names, used, strict=True)]
    return Dialect(header=tuple(names)).names(names), above[at]


def _uncommented(header: list[str], line: Sequence[str]) -> list[str]:
    """The header in a line without a comment mark before it; divided at blanks if that gives as many names."""
    if not header[0].startswith(("#", "%", "//")):
        return header
    bare = " ".join(line).lstrip("#%/ ").split()
    return bare if len(bare) == len(header) else [header[0].lstrip("#%/ ") or header[0], *header[1:]]


def _all_units(cells: Sequence[str]) -> bool:
    words = [cell.strip("[]() ").lower() for cell in cells if cell]
    return bool(words) and sum(cell in UNIT or cell in ("-", "1") for cell in words) > 0.6 * len(words)


def _decimal(cells: Sequence[str]) -> str:
    """The decimal sign of most numbers in a sample of the cells."""
    cells = cells[:: max(1, len(cells) // MOST_LOOKED_AT)]
    commas = sum(bool(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", _bare(cell))) for cell in cells)
    points = sum(bool(re.fullmatch(r"[+-]?\d*\.\d+([eE][+-]?\d+)?", _bare(cell))) for cell in cells)
    return "," if commas > points else "."


def _bare(cell: str) -> str:
    """A cell without the unit after its number, and with an ASCII minus sign."""
    figure, _, unit = cell.replace("−", "-").rstrip().rpartition(" ")
    if figure and unit.lower() in UNIT:
        return figure.strip()
    return cell.replace("−", "-").rstrip("°")


def _column(name: str, cells: Sequence[str], decimal: str) -> ForeignColumn:
    plain, unit = split_title(name)
    figures = np.array([figure_of(cell, decimal) for cell in cells])
    return ForeignColumn(plain, unit, pd.Series(list(cells), dtype=object), figures)


def figure_of(cell: str, decimal: str) -> float:
    """Return a cell's number, or nan; thousands separators and a unit are allowed, dates become seconds since 1970."""
    if decimal == "." and "_" not in cell:
        try:
            return float(cell)
        except ValueError:
            pass
    bare = _bare(cell)
    if _THOUSANDS[decimal].fullmatch(bare) and ("," in bare and "." in bare):
        bare = bare.replace("." if decimal == "," else ",", "")
    if decimal == ",":
        bare = bare.replace(".", "?").replace(",", ".")
    try:
        return float(bare) if bare and "_" not in bare else np.nan
    except ValueError:
        return _seconds(cell)


def _seconds(cell: str) -> float:
    """A date, or a time of day, in seconds since 1970, or since midnight; nan if it is neither."""
    if ":" not in cell:
        return np.nan
    text = cell.strip().replace(",", ".")
    text = re.sub(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})", r"\3-\2-\1", text)  # German order of day, month and year
    for day in ("", "1970-01-01T"):
        with suppress(ValueError):
            moment = datetime.fromisoformat(f"{day}{text}")
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return np.nan


def name_words(name: str) -> list[str]:
    """Return the words of a name in lower case, split at separators and at capitals inside a word (`JointPos`)."""
    apart = re.sub(r"(?<=[a-zäöüß])(?=[A-Z])", " ", name)
    return re.findall(r"[a-zäöüßθδ]+\d*|\d+|#", apart.lower())


def split_title(title: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit in calflow's spelling (empty if none is stated)."""
    for bracketed in _BRACKETED.finditer(title):
        if unit := UNIT.get(bracketed[1].lower()):
            return (title[: bracketed.start()] + title[bracketed.end() :]).strip(), unit
    name, sign, last = re.match(r"(.*?)([\s_/,.]+)?([^\s_/,.]*)$", title).groups()  # type: ignore[union-attr]
    quantity = QUANTITIES.get(last.lower())
    if sign and name and (unit := UNIT.get(last.lower())) and (not quantity or quantity & {*name_words(name)}):
        return name.strip(), unit
    if title.endswith("°") and len(title) > 1:
        return title[:-1].strip(), "deg"
    return title.strip(), ""
