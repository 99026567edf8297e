"""Deviations: where two versions of one table or document differ, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calflow.files.tables import Column, column, columns

ROWS = "rows"  # what differs where two tables are not equally long
NUMBERS = (int, float)


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """A column of a table, or a key of a summary, that came out otherwise."""

    file: str = column("the table or summary, by its path in the run folder")
    name: str = column(
        "its column or key; `rows`: it has another number of rows, and no more is compared", name="column"
    )
    cells: int = column("how many of its cells differ")
    was: str = column("the first of them as it was; of numbers the one that differs most")
    now: str = column("what came out instead")
    absolute: float | None = column("largest difference, in the column's unit; empty: no numbers")
    relative: float | None = column("the same over the larger of the two numbers")
    in_sd: float | None = column("largest difference in standard deviations as the table had them; empty: it has none")


def table_deviations(file: str, was: pd.DataFrame, now: pd.DataFrame, row_type: type) -> list[Deviation]:
    """Return the columns in which two tables of texts (as read without any conversion) differ; row_type declares them."""
    if len(was) != len(now):
        return [_texts(file, ROWS, abs(len(was) - len(now)), str(len(was)), str(len(now)))]
    found = []
    for name in dict.fromkeys((*was, *now)):
        if name not in was or name not in now:
            there = ("there", "not there") if name in was else ("not there", "there")
            found.append(_texts(file, name, len(was), *there))
        elif (differ := (was[name] != now[name]).to_numpy()).any():
            declared = next((one for one in columns(row_type) if one.matches(name)), None)
            found.append(_column(file, name, was, now, differ, declared))
    return found


def document_deviations(file: str, was: Any, now: Any) -> list[Deviation]:
    """Return the keys, dotted, in which two documents differ."""
    first, second = _flat("", was), _flat("", now)
    found = []
    for key in dict.fromkeys((*first, *second)):
        one, other = first.get(key), second.get(key)
        if one == other:
            continue
        if isinstance(one, NUMBERS) and isinstance(other, NUMBERS) and not isinstance(one, bool):
            found.append(_numbers(file, key, 1, float(one), float(other), None))
        else:
            found.append(_texts(file, key, 1, str(one), str(other)))
    return found


def _column(
    file: str, name: str, was: pd.DataFrame, now: pd.DataFrame, differ: np.ndarray, declared: Column | None
) -> Deviation:
    first = int(np.flatnonzero(differ)[0])
    if declared is None or declared.many or declared.kind not in NUMBERS:
        return _texts(file, name, int(differ.sum()), was[name].iloc[first], now[name].iloc[first])
    one, other = (pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float) for table in (was, now))
    apart = np.where(differ, np.abs(other - one), 0.0)
    if np.isnan(apart).any():  # a cell that is empty in one of the two
        k = int(np.flatnonzero(np.isnan(apart))[0])
        return _texts(file, name, int(differ.sum()), was[name].iloc[k], now[name].iloc[k])
    k = int(np.argmax(apart))
    sd = pd.to_numeric(was[declared.sd], errors="coerce").to_numpy(dtype=float) if declared.sd in was else None
    known = sd is not None and bool((sd[differ] > 0).any())
    in_sd = float(np.nanmax(apart[differ] / np.where(sd[differ] > 0, sd[differ], np.nan))) if known else None  # type: ignore[index]
    return _numbers(file, name, int(differ.sum()), one[k], other[k], in_sd)


def _numbers(file: str, name: str, cells: int, was: float, now: float, in_sd: float | None) -> Deviation:
    apart, larger = abs(now - was), max(abs(was), abs(now))
    return Deviation(file=file, name=name, cells=cells, was=f"{was:.10g}", now=f"{now:.10g}", absolute=apart,
                     relative=apart / larger if larger else 0.0, in_sd=in_sd)  # fmt: skip


def _texts(file: str, name: str, cells: int, was: str, now: str) -> Deviation:
    return Deviation(file=file, name=name, cells=cells, was=was, now=now, absolute=None, relative=None, in_sd=None)


def _flat(key: str, value: Any) -> dict[str, Any]:
    """A document's values by their dotted keys."""
    members = value.items() if isinstance(value, Mapping) else enumerate(value, 1) if isinstance(value, list) else None
    if members is None:
        return {key: value}
    return {k: v for name, one in members for k, v in _flat(f"{key}.{name}" if key else str(name), one).items()}
