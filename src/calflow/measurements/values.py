"""The values of a measurement file's columns: cells as numbers in SI units or as labels, and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.files.problems import Problem, shortened
from calflow.files.units import LARGEST, SUFFIXES, to_si
from calflow.measurements.checks import at_rows
from calflow.measurements.header import ReadColumn
from calflow.measurements.layout import Layout

NUMBER = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"
NOTHING = ("", "nan", "-nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none")
WRONG_UNIT = 1000.0  # times what a robot has: so far a value may lie, and be told as one in a wrong unit


@dataclass(frozen=True)
class Values:
    """A column's values by line, nan where there is none, which cells are empty, and what is wrong with the others."""

    values: pd.Series
    empty: pd.Series
    problems: list[Problem]


def values_of(cells: pd.Series, column: ReadColumn, layout: Layout, path: Path) -> Values:
    """Return a column's values in SI units."""
    never = pd.Series(False, cells.index)
    if column.name in ("marker", "payload", "session", "split", *layout.reports.labels):
        return Values(_text(cells), never, [])
    if column.name in ("pose", "repeat"):
        labels = _text(cells).str.replace(r"\.0*$", "", regex=True)
        problems = at_lines(labels == "", path, f"{column} is empty")
        whole = labels.str.fullmatch(r"[0-9]{1,18}").all()
        return Values(labels.astype(int) if whole else labels, never, problems)
    return numbers(cells, column, layout, path)


def numbers(cells: pd.Series, column: ReadColumn, layout: Layout, path: Path) -> Values:
    """Return a column's numbers in SI units."""
    if pd.api.types.is_numeric_dtype(cells):
        figures, text = cells.astype(float), pd.Series(False, cells.index)
        empty = ~pd.Series(np.isfinite(figures), cells.index)
    else:
        written = _text(cells)
        if layout.decimal == ",":
            written = written.str.replace(".", "?", regex=False).str.replace(",", ".", regex=False)
        good = written.str.fullmatch(NUMBER)
        empty = written.str.lower().isin(NOTHING)
        text = ~good & ~empty
        figures = written.where(good).astype(float)  # infinite where a figure is too large to be held
    factor, offset = to_si(column.unit) if column.unit else (1.0, 0.0)
    values = factor * figures + offset
    dimension = next((name for name, units in SUFFIXES.items() if column.unit in units), "")
    large = pd.Series(beyond(values.where(~empty, 0.0).to_numpy(), dimension), cells.index)
    problems = [Problem(_no_number(cells[text], column, layout), path, int(cells.index[text][0]))] if text.any() else []
    problems += at_lines(large, path, f"{column}: {beyond_words(dimension)}")
    return Values(values.where(~(empty | large)), empty, problems)


def at_lines(bad: pd.Series, path: Path, message: str) -> list[Problem]:
    """One problem a line for the first few bad cells, and one that counts the rest."""
    return at_rows(bad.to_numpy(dtype=bool), pd.DataFrame({"line": bad.index}), path, message)


def beyond(values: np.ndarray, dimension: str) -> np.ndarray:
    """Which values [SI] are larger than anything in a wrong unit could be, shape as values."""
    return np.abs(values) > WRONG_UNIT * LARGEST[dimension]


def beyond_words(dimension: str) -> str:
    """Say what is the largest value that is read."""
    si = f" {SUFFIXES[dimension][0]}" if dimension else ""
    return f"expected at most {WRONG_UNIT * LARGEST[dimension]:g}{si}"


def _no_number(wrong: pd.Series, column: ReadColumn, layout: Layout) -> str:
    """Say that cells hold no number."""
    first, more = shortened(str(wrong.iloc[0])), len(wrong) - 1
    other = "," if layout.decimal == "." else "."
    hint = f" (written with '{other}'? say decimal = \"{other}\" in the study)" if other in first else ""
    count = f" (and {more} more rows)" if more else ""
    return f"{column}: expected a number, found '{first}'{hint}{count}"


def _text(cells: pd.Series) -> pd.Series:
    return cells.where(cells.notna(), "").astype(str)
