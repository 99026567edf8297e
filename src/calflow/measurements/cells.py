"""Reading a measurement file, a CSV, a sheet of a workbook or a MATLAB file's arrays, into a table of text cells.

A `Dialect` states how a program writes its tables: separator, decimal sign, encoding and position of the header line.
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calflow.files.deferred import pd
from calflow.files.problems import CONTROL, Problem, nearest, refuse, refuse_any, regular_file, truncated
from calflow.files.words import plural

MAX_ROWS_TOLD = 5  # a message names this many rows of a kind, and counts the others
REMEDY = 'save it as "CSV UTF-8 (comma delimited)", as Excel calls it'
NAME_ENCODING = 'or name its own in the study\'s [measurements]: encoding = "{}"'
ARCHIVE, OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"  # signatures of .xlsx and .xls
WORKBOOKS = (".xlsx", ".xlsm")
LARGEST_WORKBOOK = 500_000_000  # bytes, unpacked
HEAD = 4096  # bytes from which the type of a file is recognised
NAMELESS = (
    'expected the columns\' names, found figures: name the columns in their order by columns = ["q1_deg", …] in the '
    "study's [measurements], or let 'calflow import' find out which is which"
)
OPEN_QUOTE = 'a quote " is opened here, and not closed in this line: expected a line a row'
TEXT_AFTER_QUOTE = (
    'a quote " is closed here, and text follows it: expected a separator, or a quote doubled inside quotes'
)
EMPTY = "is empty: expected a header line and a row per measured point"


@dataclass(frozen=True)
class Dialect:
    """The format of a table.

    separator is one character; a blank means any number of blanks and tabs. header_line is the line of the column
    names, counted from 1; lines before it are not read. header gives the column names, in order, of a file without a
    header line, or replaces the file's ("": a column that is not read); rows then begin after header_line. sheet names
    the sheet of a workbook, and may be empty if there is only one.

    Raises:
        ValueError: separator, decimal, encoding or header line is invalid.
    """

    separator: str = ","
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    header_line: int = 1
    header: tuple[str, ...] = ()
    sheet: str = ""

    def __post_init__(self) -> None:
        if len(self.separator) != 1:
            raise ValueError(f"separator: expected one character, found {self.separator!r}")
        if self.separator == self.decimal:
            raise ValueError(
                f"separator and decimal are both {self.decimal!r}; columns are usually separated by ';' then"
            )
        try:
            "".encode(self.encoding)
        except LookupError:
            near = nearest(self.encoding, ("utf-8", "utf-16", "cp1252", "latin-1", "cp437", "mac-roman", "shift-jis"))
            raise ValueError(
                f"encoding: expected a name such as utf-8 or cp1252, found {self.encoding!r}{near}"
            ) from None
        if self.header_line < (0 if self.header else 1):
            raise ValueError("header_line: expected a line's number, counted from 1")

    def names(self, there: Sequence[str]) -> list[str]:
        """Return the column names of the header line, numbering those that occur several times: `x (1)`, `x (2)`."""
        names, times = [name.strip() for name in self.header or there], Counter[str]()
        often = Counter(names)
        for k, name in enumerate(names):
            times[name] += 1
            if name and often[name] > 1:
                names[k] = f"{name} ({times[name]})"
        return names


def at_rows(bad: Any, table: pd.DataFrame, path: Path | None, message: str, earlier: Any = None) -> list[Problem]:
    """Return a problem for each of the first few bad rows, and one that counts the others.

    earlier (n_rows,) is the line of the row that each contradicts, if any, with which the message ends.
    """
    wrong, line = np.asarray(bad, dtype=bool), table["line"].to_numpy()
    contradicted = line if earlier is None else np.asarray(earlier)
    lines = dict(zip(line[wrong].tolist(), contradicted[wrong].tolist(), strict=True))
    kind, problems = "line" if path else "row", list[Problem]()
    for at, first in list(lines.items())[:MAX_ROWS_TOLD]:
        told = message if earlier is None else f"{message} in {kind} {first}"
        problems.append(Problem(told, path, at) if path else Problem(told, key=f"row {at}"))
    if further := len(lines) - len(problems):
        told = message if earlier is None else f"{message} in earlier rows"
        problems.append(Problem(f"{told} (and {plural(further, 'more row')})", path))
    return problems


def read_cells(path: Path, dialect: Dialect, named: Collection[str] = ()) -> pd.DataFrame:
    """Return the file's cells as text (a MATLAB file's as numbers), indexed by line number, without empty lines.

    named are the columns to read; all if it is empty.

    Raises:
        InputError: the file is not a table.
    """
    try:
        regular_file(path)
        if path.suffix.lower() == ".mat":
            return _read_mat(path, named)
        sheet = path.suffix.lower() in WORKBOOKS
        raw = _sheet_cells(path, dialect) if sheet else _text_cells(path, dialect, named)
    except pd.errors.EmptyDataError:
        raise refuse(EMPTY, path) from None
    except (OSError, ValueError, csv.Error) as error:
        raise refuse(f"cannot be read: {str(error).strip()}", path) from None
    raw = raw.loc[:, [name for name in raw if name != ""]]
    raw = raw.fillna("").apply(lambda column: column.str.strip())
    raw = raw[(raw != "").any(axis=1)]
    if raw.empty:
        raise refuse(EMPTY, path)
    return raw


def read_text_of(path: Path, dialect: Dialect) -> str:
    """Return a file's decoded text, with its line endings unchanged.

    Raises:
        InputError: the file is an Excel file, text in another encoding, or not text.
    """
    content = path.read_bytes()
    head = content[:HEAD]
    if head.startswith((ARCHIVE, OLE)):
        raise refuse(f"is an Excel file (or another archive), not a CSV: {REMEDY}, or as .xlsx", path)
    even, odd = head[::2], head[1::2]
    a_byte_a_sign = len("a".encode(dialect.encoding)) == 1
    if a_byte_a_sign and (
        head.startswith((b"\xff\xfe", b"\xfe\xff")) or (b"\0" in head and not (any(even) and any(odd)))
    ):
        raise refuse(f"is not a text file in UTF-8 but in UTF-16: {REMEDY}, {NAME_ENCODING.format('utf-16')}", path)
    undecoded = None
    try:
        text = content.decode(dialect.encoding)
    except UnicodeDecodeError as error:
        undecoded, text = error, content[: error.start].decode(dialect.encoding)
    shown = text.replace(dialect.separator, "")
    if control := CONTROL.search(shown):
        line = shown.count("\n", 0, control.start()) + 1
        raise refuse(f"is not a text file: expected a CSV, found the control character {control.group()!r}", path, line)
    if undecoded:
        sign = content[undecoded.start : undecoded.start + 1]
        reading = (
            f"is not in {dialect.encoding.upper()}: byte {sign[0]:#x} would be {sign.decode('latin-1')!r} in Latin-1; "
        )
        raise refuse(f"{reading}{REMEDY}, {NAME_ENCODING.format('cp1252')}", path, text.count("\n") + 1)
    return text.removeprefix("\ufeff")


def csv_lines(text: str, separator: str) -> Any:
    """Return a CSV reader: an iterator over the rows as lists of cells, with the attribute `line_num`."""
    blanks = separator == " "
    plain = (line.strip().replace("\t", " ") for line in text.splitlines())
    lines = plain if blanks else io.StringIO(text, newline="")
    return csv.reader(lines, delimiter=separator, skipinitialspace=blanks, strict=True)


def _text_cells(path: Path, dialect: Dialect, named: Collection[str]) -> pd.DataFrame:
    """Return the cells of a text file.

    Raises:
        InputError: rows differ in length from the header, a cell spans several lines, or a column to read occurs twice.
    """
    text = read_text_of(path, dialect)
    names, widest = _checked_shape(text, path, dialect, named)
    names += [""] * (widest - len(names))
    raw = pd.read_csv(
        io.StringIO(text), sep=r"\s+" if dialect.separator == " " else dialect.separator, dtype=str,
        keep_default_na=False, skip_blank_lines=False, header=None, names=range(len(names)), index_col=False,
        skiprows=dialect.header_line,
    )  # fmt: skip
    first = dialect.header_line + 1
    return raw.set_axis(names, axis=1).set_axis(pd.RangeIndex(first, len(raw) + first))


def _checked_shape(text: str, path: Path, dialect: Dialect, named: Collection[str]) -> tuple[list[str], int]:
    """Return the column names and the length of the longest row, after checking that cells beyond the names are empty.

    Rows may end after the last column that is read.
    """
    lines = _a_line_a_row(text, path, dialect)
    there = _header_cells(lines, path, dialect)
    names = dialect.names(there)
    fewer, more, widest = [], [], len(names)
    alone = next(iter(filter(None, names)), "") if sum(map(bool, names)) == 1 and not dialect.header else ""
    least = max((k for k, name in enumerate(names, start=1) if name in (named or names)), default=0)
    for line, cells in enumerate(lines, start=dialect.header_line + 1):
        if alone and (sum(bool(cell.strip()) for cell in cells) > 1 or _other_separator(cells)):
            raise refuse(
                f"expected the header line, found '{truncated(alone)}': leave out what precedes it, or say header_line = {line} "
                "in the study's [measurements]", path, dialect.header_line,
            )  # fmt: skip
        if any(cell.strip() for cell in cells[len(names) :]):
            more.append(line)
        elif len(cells) < least and any(cells):
            fewer.append(line)
        widest = max(widest, len(cells))
    plain = [name.strip() for name in dialect.header or there]
    if not dialect.header and sum(map(_is_number, plain)) > len(plain) / 2:
        raise refuse(NAMELESS, path, dialect.header_line)
    twice = [name for name, times in Counter(plain).items() if name and times > 1 and name in (named or plain)]
    problems = [_duplicate_column(name, names, path, dialect, named) for name in twice]
    for wrong, word in ((fewer, "fewer"), (more, "more")):
        message = f"has {word} values than the {len(names)} names of the header line"
        problems += at_rows(np.full(len(wrong), True), pd.DataFrame({"line": wrong}), path, message)
    refuse_any(problems)
    return names, widest


def _a_line_a_row(text: str, path: Path, dialect: Dialect) -> Iterator[list[str]]:
    """Yield the cells of each line.

    Raises:
        InputError: a quote is not closed in its line, or text follows where it is.
    """
    lines = csv_lines(text, dialect.separator)
    for line in count(1):
        try:
            cells = next(lines)
        except StopIteration:
            return
        except csv.Error as error:
            closed = lines.line_num == line and "expected after" in str(error)
            raise refuse(TEXT_AFTER_QUOTE if closed else OPEN_QUOTE, path, line) from None
        if lines.line_num != line:
            raise refuse(OPEN_QUOTE, path, line)
        yield cells


def _header_cells(lines: Iterator[list[str]], path: Path, dialect: Dialect) -> list[str]:
    """Return the cells of the header line, the last that is read of a file's lines; none without one."""
    heads = list(islice(lines, dialect.header_line))
    there = heads[-1] if heads else []
    found, wanted = len(heads), dialect.header_line
    if found < wanted:
        raise refuse(EMPTY if found <= 1 else f"has {found} lines: expected the header in line {wanted}", path)
    if len(there) == 1 and not dialect.header:
        _check_separator(path, there[0], dialect)
    return there


def _is_number(cell: str) -> bool:
    """Whether a cell holds a number, with a decimal point or comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _duplicate_column(name: str, names: Sequence[str], path: Path, dialect: Dialect, named: Collection[str]) -> Problem:
    """Return the problem of a column name that occurs twice, with the numbered names that a mapping can use."""
    each = " and ".join(f"'{title}'" for title in names if title.startswith(f"{name} ("))
    hint = f"; in a mapping they are {truncated(each, 200)}" if named else ""
    return Problem(
        f"column '{truncated(name)}' is there twice: expected each name once{hint}", path, dialect.header_line or None
    )


def _other_separator(cells: Sequence[str]) -> str:
    """Return the separator that a line may have been written with which is read as a single cell; empty: none."""
    return next((sign for sign in ";\t|," if len(cells) == 1 and sign in cells[0]), "")


def _check_separator(path: Path, header: str, dialect: Dialect) -> None:
    """Refuse a header of a single cell that contains another separator."""
    if other := _other_separator([header]):
        raise refuse(f"has no {dialect.separator!r} in its header line, but {other!r}: say separator = {json.dumps(other)} "
                     "in the study's [measurements] (and decimal = \",\" where numbers have a decimal comma); new rows for a "
                     "run must be written as its study's measurements are, and 'calflow import' writes an instrument's so",
                     path, dialect.header_line)  # fmt: skip


def sheets_of(path: Path) -> dict[str, list[list[str]]]:
    """Return the rows of every non-empty sheet of a workbook, with cells as text, by sheet name.

    Formulas have the values computed when the workbook was saved; numbers have a decimal point.

    Raises:
        InputError: the file is not a workbook, or the package that reads one is not installed.
    """
    try:
        import openpyxl
    except ImportError:
        raise refuse(
            f"is a workbook, which the extra 'sheets' reads: pip install calflow[sheets]; or {REMEDY}", path
        ) from None
    try:
        unpacked = sum(member.file_size for member in zipfile.ZipFile(path).infolist())
        if unpacked > LARGEST_WORKBOOK:
            raise refuse(f"is {unpacked / 1e6:.0f} MB unpacked: expected at most {LARGEST_WORKBOOK / 1e6:g}", path)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = {}
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # some programs state others than they write
            sheets[sheet.title] = [[_cell_text(cell) for cell in row] for row in sheet.iter_rows(values_only=True)]
        book.close()
    except (zipfile.BadZipFile, KeyError, ValueError, EOFError, SyntaxError) as error:
        raise refuse(f"cannot be read as a workbook ({error}): {REMEDY}", path) from None
    return {name: rows for name, rows in sheets.items() if any(map(any, rows))}


def _cell_text(cell: Any) -> str:
    return "" if cell is None else cell.isoformat() if hasattr(cell, "isoformat") else str(cell)


def chosen_sheet(path: Path, sheet: str) -> list[list[str]]:
    """Return the rows of the named sheet of a workbook, or of its only sheet if the name is empty.

    Raises:
        InputError: there is no such sheet, or the name is empty and there are several.
    """
    sheets = sheets_of(path)
    if not sheets:
        raise refuse(EMPTY, path)
    there = ", ".join(f"'{truncated(name)}'" for name in sheets)
    if sheet and sheet not in sheets:
        raise refuse(f"no sheet '{sheet}'{nearest(sheet, sheets)}; there are {there}", path)
    if not sheet and len(sheets) > 1:
        raise refuse(f"has several sheets: say sheet = … in the study's [measurements], one of {there}", path)
    return sheets[sheet or next(iter(sheets))]


def _sheet_cells(path: Path, dialect: Dialect) -> pd.DataFrame:
    """Return the cells of a workbook's sheet, with numbers in the dialect's decimal sign.

    Raises:
        InputError: the sheet cannot be chosen, or ends before the header line.
    """
    rows = chosen_sheet(path, dialect.sheet)
    if len(rows) < dialect.header_line:
        raise refuse(f"has {len(rows)} lines: expected the header in line {dialect.header_line}", path)
    names = dialect.names(rows[dialect.header_line - 1] if dialect.header_line else [])
    body = rows[dialect.header_line :]
    wide = max([len(names), *map(len, body)])
    table = pd.DataFrame([row + [""] * (wide - len(row)) for row in body], columns=range(wide), dtype=str)
    first = dialect.header_line + 1
    table = table.set_axis(names + [""] * (wide - len(names)), axis=1).set_axis(pd.RangeIndex(first, len(body) + first))
    return (
        table.map(lambda cell: cell.replace(".", ",") if _is_figure(cell) else cell)
        if dialect.decimal == ","
        else table
    )


def _is_figure(cell: str) -> bool:
    return cell.count(".") == 1 and cell.replace(".", "").replace("-", "").replace("e", "").isdigit()


def _read_mat(path: Path, named: Collection[str]) -> pd.DataFrame:
    """Return the arrays of which columns are named (all if none are), with one table column per column of an array."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        arrays = {name: np.asarray(value) for name, value in loadmat(path).items() if not name.startswith("__")}
    except (MatReadError, NotImplementedError, TypeError, KeyError) as error:
        raise ValueError(error) from None
    read = {theirs.rpartition("_")[0] for theirs in named} or set(arrays)
    wide = {name: array.reshape(len(array), -1) for name, array in arrays.items() if name in read and array.ndim}
    table = pd.DataFrame({f"{name}_{j + 1}": a[:, j] for name, a in wide.items() for j in range(a.shape[1])})
    return table.set_axis(pd.RangeIndex(1, len(table) + 1))
