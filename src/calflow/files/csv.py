"""CSV: how every table of calflow is written and read.

A text that a spreadsheet would compute, such as `=1+1`, has an apostrophe before it in the file, by which spreadsheets know a text;
so has one that begins with apostrophes and goes on like that. Numbers, and lists of them in a cell, are as they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from calflow.files.writing import write_text

FLOATS = "%.10g"  # more than any measurement supports, fewer than rounding disturbs
# pandas before 3.1 reads the last bit of a number as it likes unless told so; later ones warn of being told.
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__.split(".")[:2] < ["3", "1"] else {}

_COMPUTED = re.compile(
    r"'*[=+\-@\t\r]"
)  # how a text begins that a spreadsheet computes, or that would be taken for a quoted one
NUMBER = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"
_NUMBERS = re.compile(rf"'*{NUMBER}(\s*;\s*{NUMBER})*")


def csv_text(table: pd.DataFrame, exact: bool = False) -> str:
    """Return a table as every CSV of calflow is written; exact: with all digits that its numbers need to be read back."""
    floats = None if exact else FLOATS
    return str(_changed(table, _quoted).to_csv(index=False, float_format=floats, lineterminator="\n"))


def write_csv(path: Path, table: pd.DataFrame, exact: bool = False) -> None:
    """Write a table whole or not at all; exact: so that it is read back to the last bit."""
    write_text(path, csv_text(table, exact))


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table that `write_csv` wrote, to the last bit; a column is of one type, however many rows it has."""
    return _changed(pd.read_csv(path, low_memory=False, **EXACT), unquoted)


def read_texts(path: Path) -> pd.DataFrame:
    """Read a table that `write_csv` wrote, every cell as the text that it is."""
    return _changed(pd.read_csv(path, dtype=str, keep_default_na=False), unquoted)


def unquoted(text: str) -> str:
    """Return a cell's text without the apostrophe that keeps it from being computed."""
    return text[1:] if text.startswith("'") and _is_computed(text) else text


def changed(cells: pd.Series, change: Callable[[str], str]) -> pd.Series:
    """Return cells with every text changed; each text is looked at once, however often it is there."""
    texts = [text for text in cells.unique() if isinstance(text, str)]
    others = {text: other for text in texts if (other := change(text)) != text}
    return cells.map(lambda cell: others.get(cell, cell)) if others else cells


def _changed(table: pd.DataFrame, change: Callable[[str], str]) -> pd.DataFrame:
    """Return a table with every text in it changed, names of columns too."""
    table = table.rename(columns=lambda name: change(name) if isinstance(name, str) else name)
    for k in range(table.shape[1]):
        if not pd.api.types.is_numeric_dtype(table.dtypes.iloc[k]):
            table.isetitem(k, changed(table.iloc[:, k], change).array)
    return table


def _quoted(text: str) -> str:
    return f"'{text}" if _is_computed(text) else text


def _is_computed(text: str) -> bool:
    return bool(_COMPUTED.match(text)) and not _NUMBERS.fullmatch(text)
