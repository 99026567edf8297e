"""Rows: a table as its values and as a DataFrame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import pandas as pd

from calflow.files.tables import from_frame

Row = TypeVar("Row")


@dataclass(frozen=True, eq=False, repr=False)
class Rows(Generic[Row], Sequence[Row]):
    """The rows of a table of the run folder; `table` is the same as a DataFrame."""

    table: pd.DataFrame
    row_type: type[Row]

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        return tuple(from_frame(self.table, self.row_type))

    def __getitem__(self, k: Any) -> Any:
        return self._rows[k]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self.table)

    def __repr__(self) -> str:
        return repr(self.table) if len(self) else f"no {self.row_type.__name__}"

    def _repr_html_(self) -> str:
        return str(self.table.to_html(index=False))
