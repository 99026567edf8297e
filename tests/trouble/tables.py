"""What a measurement file says, read strictly and apart from calflow, and where calflow's rows differ from it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pandas as pd

FACTORS = {
    "m": 1.0, "mm": 1e-3, "um": 1e-6, "rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3, "urad": 1e-6,
    "arcsec": math.pi / 648_000, "s": 1.0, "min": 60.0, "h": 3600.0, "K": 1.0, "degC": 1.0, "N": 1.0, "kN": 1e3, "Nm": 1.0,
    "kNm": 1e3,
}  # fmt: skip
TEXTS = ("marker", "payload", "session", "split")
LABELS = ("pose", "repeat")
MEASURED = ("x", "y", "z")
NO_VALUE = ("", "nan", "-nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none")


def strict_rows(path: Path, separator: str, named: Collection[str] = ()) -> list[list[str]] | str:
    """Return the lines of a table as cells, or why it is none: text in UTF-8, no control characters, as wide as its header."""
    try:
        text = path.read_bytes().decode("utf-8").lstrip("\ufeff")
    except UnicodeDecodeError:
        return "not UTF-8"
    if re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", text.replace(separator, "")):
        return "control characters"
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True))
    except csv.Error as error:
        return str(error)
    if any("\n" in cell or "\r" in cell for row in rows for cell in row):
        return "a cell of several lines"
    filled = [row for row in rows if any(cell.strip() for cell in row)]
    if not filled or filled[0] is not rows[0]:
        return "no header"
    header = [cell.strip() for cell in rows[0]]
    read = [k for k, name in enumerate(header) if name in (named or header)]
    if len({header[k] for k in read}) < len(read):
        return "a column there twice"
    fits = all(max(read) < len(row) <= len(header) for row in filled)
    return rows if fits else "rows of another length than the header"


def differences(
    path: Path,
    read: pd.DataFrame,
    notes: str,
    separator: str = ",",
    decimal: str = ".",
    columns: Mapping[str, str] | None = None,
    markers: Mapping[str, Mapping[str, str]] | None = None,
) -> Iterator[str]:
    """Say where the rows that calflow read are not those of the file: cells, columns and rows that went missing or were changed."""
    named = {theirs for own in (columns or {}, *(markers or {}).values()) for theirs in own.values()}
    rows = strict_rows(path, separator, named)
    if isinstance(rows, str):
        yield f"accepted what is no table: {rows}"
        return
    header = [cell.strip() for cell in rows[0]]
    said = {
        line: dict(zip(header, row, strict=False)) for line, row in enumerate(rows[1:], 2) if any(map(str.strip, row))
    }
    mapping = {"": dict(columns or {})} if columns or markers else {"": {name: name for name in header}}
    groups = {name: mapping[""] | own for name, own in (markers or {}).items()} or mapping
    left_out, seen = 0, set()
    for marker, own in groups.items():
        table = read[read["marker"] == marker] if marker else read
        by_line = table.set_index("line")
        if not by_line.index.is_unique:
            yield "a line was read twice"
            return
        for line, cells in said.items():
            if line in by_line.index:
                seen.add((marker, line))
                yield from _cells(line, cells, own, by_line.loc[line], decimal)
            elif any(
                cells[name].strip().lower() in NO_VALUE for ours, name in own.items() if _split(ours)[0] in MEASURED
            ):
                left_out += 1
            else:
                yield f"line {line} was dropped"
    if len(seen) != len(read):
        yield "rows that the file does not hold"
    if left_out and f"{left_out} of " not in notes:
        yield f"{left_out} rows left out without a word"


def _cells(line: int, cells: Mapping[str, str], own: Mapping[str, str], row: pd.Series, decimal: str) -> Iterator[str]:
    for ours, theirs in own.items():
        name, factor = _split(ours)
        text = cells[theirs].strip()
        if name not in row.index:
            yield f"column {theirs} was not read"
        elif name in LABELS:
            if str(row[name]).lstrip("0") != re.sub(r"\.0*$", "", text).lstrip("0"):
                yield f"line {line}, {theirs}: {text!r} became {row[name]!r}"
        elif name in TEXTS:
            if row[name] != text:
                yield f"line {line}, {theirs}: {text!r} became {row[name]!r}"
        elif (value := _number(text, decimal)) is None or not _same(_si(ours, value, factor), row[name]):
            yield f"line {line}, {theirs}: {text!r} became {row[name]!r}"


def _split(column: str) -> tuple[str, float | None]:
    stem, _, unit = column.rpartition("_")
    return (stem, FACTORS[unit]) if unit in FACTORS and stem else (column, None)


def _si(column: str, value: float, factor: float | None) -> float:
    return (1.0 if factor is None else factor) * value + (273.15 if column.endswith("_degC") else 0.0)


def _same(said: float, read: float) -> bool:
    return math.isclose(said, read, rel_tol=1e-12, abs_tol=1e-300)


def _number(text: str, decimal: str) -> float | None:
    point = re.escape(decimal)
    if not re.fullmatch(rf"[+-]?([0-9]+{point}?[0-9]*|{point}[0-9]+)([eE][+-]?[0-9]+)?", text):
        return None
    value = float(text.replace(decimal, "."))
    return value if math.isfinite(value) else None
