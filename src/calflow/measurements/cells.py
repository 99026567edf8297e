"""The cells of a measurement file: a CSV's as text, a MATLAB file's as numbers, each known by its line.

Plain text: what a measurement file must be before its cells are read.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.files.problems import CONTROL, InputError, Problem, refuse, shortened
from calflow.files.regular import regular_file
from calflow.measurements.checks import at_rows
from calflow.measurements.layout import Layout

REMEDY = 'save it as "CSV UTF-8 (comma delimited)", as Excel calls it'
ARCHIVE, OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"  # how .xlsx and .xls begin
HEAD = 4096  # bytes that tell what a file is


def check_text(path: Path, separator: str = ",") -> None:
    """Refuse what is not text in UTF-8, with what to do about it.

    Raises:
        InputError: it is an Excel file, text in another encoding, or no text.
    """
    with path.open("rb") as stream:
        head = stream.read(HEAD)
        if head.startswith((ARCHIVE, OLE)):
            raise refuse(f"is an Excel file (or another archive), not a CSV: {REMEDY}", path)
        even, odd = head[::2], head[1::2]
        if head.startswith((b"\xff\xfe", b"\xfe\xff")) or (b"\0" in head and not (any(even) and any(odd))):
            raise refuse(f"is not a text file in UTF-8 but in UTF-16: {REMEDY}", path)
        stream.seek(0)
        for line, text in enumerate(stream, start=1):
            try:
                signs = text.decode()
            except UnicodeDecodeError as error:
                sign = text[error.start : error.start + 1]
                raise refuse(f"is not in UTF-8: byte {sign[0]:#x} would be {sign.decode('latin-1')!r} in Latin-1; {REMEDY}",
                             path, line) from None  # fmt: skip
            control = CONTROL.search(signs.replace(separator, ""))
            if control:
                raise refuse(
                    f"is not a text file: expected a CSV, found the control character {control.group()!r}", path, line
                )


EMPTY = "is empty: expected a header line and a row per measured point"


def layout_of_further(path: Path, layout: Layout) -> Layout:
    """Return the layout of a series' further file: the series' own, or calflow's names for one that has none of its columns.

    Poses that calflow proposed, with what was measured filled in, are such a file.
    """
    if not layout.named or set(layout.named) & set(map(str, read_cells(path, layout))):
        return layout
    return replace(layout, columns={}, markers={})


def read_cells(path: Path, layout: Layout) -> pd.DataFrame:
    """Return the file's cells as text (numbers of a MATLAB file as they are), indexed by line; empty lines are left out.

    Raises:
        InputError: the file is not a table.
    """
    try:
        regular_file(path)
        if path.suffix.lower() == ".mat":
            return _read_mat(path, layout)
        check_text(path, layout.separator)
        _check_shape(path, layout)
        raw = pd.read_csv(path, sep=layout.separator, dtype=str, keep_default_na=False, skip_blank_lines=False,
                          encoding="utf-8-sig")  # fmt: skip
    except FileNotFoundError:
        raise refuse("no such file", path) from None
    except pd.errors.EmptyDataError:
        raise refuse(EMPTY, path) from None
    except (OSError, ValueError, csv.Error) as error:
        raise refuse(f"cannot be read: {str(error).strip()}", path) from None
    raw.index = pd.RangeIndex(2, len(raw) + 2)
    raw = raw.fillna("").apply(lambda column: column.str.strip())
    raw = raw[(raw != "").any(axis=1)]
    if raw.empty:
        raise refuse(EMPTY, path)
    return raw


def _check_shape(path: Path, layout: Layout) -> None:
    """Refuse a table whose lines are not as wide as its header, or whose cells run over several lines: cells would be shifted.

    Columns beyond the last one that is read may be missing.

    Raises:
        InputError: the table is such, or a column that is read is there twice.
    """
    fewer, more = [], []
    with path.open(encoding="utf-8-sig", newline="") as stream:
        lines = csv.reader(stream, delimiter=layout.separator, strict=True)
        header = next(lines, [])
        if len(header) == 1:
            _check_separator(path, header[0], layout)
        least = max((k for k, name in enumerate(header, start=1) if name in (layout.named or header)), default=0)
        for line, cells in enumerate(lines, start=2):
            if lines.line_num != line:
                raise refuse('a quote " is opened here, and closed in another line: expected a line a row', path, line)
            if len(cells) > len(header):
                more.append(line)
            elif len(cells) < least and any(cells):
                fewer.append(line)
    twice = [name for name, times in Counter(header).items() if times > 1 and name in (layout.named or header)]
    problems = [
        Problem(f"column '{shortened(name)}' is there twice: expected each name once", path, 1) for name in twice
    ]
    for wrong, word in ((fewer, "fewer"), (more, "more")):
        message = f"has {word} values than the {len(header)} names of the header line"
        problems += at_rows(np.full(len(wrong), True), pd.DataFrame({"line": wrong}), path, message)
    if problems:
        raise InputError(problems)


def _check_separator(path: Path, header: str, layout: Layout) -> None:
    """Refuse a header that another separator would take apart."""
    other = next((sign for sign in ";\t|," if sign in header), None)
    if other:
        raise refuse(f"has no {layout.separator!r} in its header line, but {other!r}: say separator = {json.dumps(other)} "
                     "in the study's [measurements] (and decimal = \",\" where numbers have a decimal comma)", path, 1)  # fmt: skip


def _read_mat(path: Path, layout: Layout) -> pd.DataFrame:
    """Return the arrays that the layout names (all where it names none), a column for each of their columns."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        arrays = {name: np.asarray(value) for name, value in loadmat(path).items() if not name.startswith("__")}
    except (MatReadError, NotImplementedError, TypeError, KeyError) as error:
        raise ValueError(error) from None
    named = {theirs.rpartition("_")[0] for theirs in layout.named} or set(arrays)
    wide = {name: array.reshape(len(array), -1) for name, array in arrays.items() if name in named and array.ndim}
    table = pd.DataFrame({f"{name}_{j + 1}": a[:, j] for name, a in wide.items() for j in range(a.shape[1])})
    return table.set_axis(pd.RangeIndex(1, len(table) + 1))
