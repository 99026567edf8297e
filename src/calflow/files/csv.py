"""CSV: how every table of calflow is written and read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from calflow.files.writing import write_text

FLOATS = "%.10g"  # more than any measurement supports, fewer than rounding disturbs
# pandas before 3.1 reads the last bit of a number as it likes unless told so; later ones warn of being told.
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if pd.__version__.split(".")[:2] < ["3", "1"] else {}


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as every CSV of calflow is written."""
    return str(table.to_csv(index=False, float_format=FLOATS, lineterminator="\n"))


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table whole or not at all."""
    write_text(path, csv_text(table))


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table that `write_csv` wrote, to the last bit; a column is of one type, however many rows it has."""
    return pd.read_csv(path, low_memory=False, **EXACT)
