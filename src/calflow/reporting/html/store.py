"""The numbers of all figures of a page: a column that several figures show is stored once, in few bytes."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pandas as pd

FEW = 256  # different values up to which a row has the number of its value, in a byte
DIGITS = "%.7g"  # of a number that is written as such: those of a float of four bytes


class Store:
    """Columns by their number, as `data.js` reads them."""

    def __init__(self) -> None:
        self._columns: dict[str, int] = {}

    @property
    def columns(self) -> list[dict[str, Any]]:
        """All columns in the order of their numbers."""
        return [json.loads(column) for column in self._columns]

    def numbers(self, data: pd.DataFrame) -> dict[str, int]:
        """Keep a table; return the number of each of its columns."""
        return {str(name): self._number(json.dumps(packed(data[name]))) for name in data}

    def _number(self, column: str) -> int:
        return self._columns.setdefault(column, len(self._columns))


def packed(values: pd.Series) -> dict[str, Any]:
    """Return a column as one of three: few different values and which a row has, numbers of four bytes, or texts."""
    codes, distinct = pd.factorize(values, use_na_sentinel=False)
    if len(distinct) <= FEW:
        return {"values": [_plain(value) for value in distinct], "codes": _encoded(codes.astype("u1"))}
    if pd.api.types.is_numeric_dtype(values):
        return {"floats": _encoded(values.to_numpy(dtype="<f4"))}
    return {"texts": [_plain(value) for value in values]}


def _plain(value: Any) -> bool | float | str | None:
    """Return a cell as JSON has it; None where nothing is known."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if pd.isna(value):
        return None
    return float(DIGITS % value) if isinstance(value, int | float | np.number) else str(value)


def _encoded(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()
