"""Given rows: a user's CSV as it stands, to be answered column beside column."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from calflow.measurements.columns import FRAME, LABELS
from calflow.measurements.measurements import Measurements
from calflow.measurements.source import MeasurementSource


def given_rows(path: Path, data: Measurements, source: MeasurementSource) -> pd.DataFrame:
    """Return the rows of a CSV that were read as data: the file's own columns and order, numbers as numbers, no empty lines."""
    given = pd.read_csv(
        path, sep=source.separator, dtype=str, keep_default_na=False, skip_blank_lines=False, encoding="utf-8-sig"
    ).fillna("")
    given = given.iloc[data.table["line"] - 2].reset_index(drop=True)
    for name in given:
        labels = name in (*LABELS, FRAME)
        given[name] = data.table[name] if labels else pd.to_numeric(given[name].str.replace(source.decimal, "."))
    return given
