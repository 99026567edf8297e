"""Deviations: the differences between two versions of a table or document, and their magnitudes."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calflow.files.deferred import pd
from calflow.files.tables import Column, column, columns

# Names given to a deviation where the tables differ in length, or hold the same rows in another order.
ROWS, ORDER = "rows", "order of rows"
NUMBERS = (int, float)
OF_ROW = "`unit`"  # in the declared unit of a column whose rows each state their own unit, in the column `unit`
UNITLESS = ("", "1")
SAME_DIGITS = 4  # agreement to fewer digits is not explained by rounding


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """A column of a table, or a key of a summary, whose values differ between two versions."""

    file: str = column("the table or summary, by its path in the run folder")
    name: str = column(
        "its column or key; `rows`: other number of rows, `order of rows`: rows reordered; then no more is compared",
        name="column",
    )
    cells: int = column("number of cells that differ")
    row: str = column("first cell of the row that `was` and `now` quote; empty: a summary, or all rows")
    was: str = column(
        "earlier value in that row; of numbers, that with the largest difference, relative to its unit's largest"
    )
    now: str = column("later value in that row")
    unit: str = column("unit of the numbers; empty: none")
    absolute: float | None = column("absolute difference in that row, in that unit; empty: no numbers")
    relative: float | None = column("the absolute difference divided by the larger of the two numbers")
    of_largest: float | None = column(
        "the same, over the column's largest number of that unit; empty: no numbers, or integers, which do not round"
    )
    in_sd: float | None = column("largest difference in standard deviations of the earlier table; empty: it has none")


def agreeing_digits(deviations: Iterable[Deviation]) -> int | None:
    """Return to how many digits of the largest number all numbers agree; None: below four, or other differences."""
    shares = [deviation.of_largest for deviation in deviations]
    finite = [share for share in shares if share is not None]
    if not finite or len(finite) < len(shares):
        return None
    digits = math.floor(-math.log10(max(*finite, sys.float_info.epsilon)))
    return digits if digits >= SAME_DIGITS else None


def table_deviations(file: str, was: pd.DataFrame, now: pd.DataFrame, row_type: type) -> list[Deviation]:
    """Return the deviations between two tables whose cells are unconverted texts; row_type declares their columns."""
    if len(was) != len(now):
        return [_texts(file, ROWS, abs(len(was) - len(now)), "", str(len(was)), str(len(now)))]
    if list(was) == list(now) and not was.equals(now) and _sorted(was) == _sorted(now):
        k = int(np.flatnonzero((was != now).any(axis=1))[0])
        moved = int((was != now).any(axis=1).sum())
        return [_texts(file, ORDER, moved, "", *(" ".join(table.iloc[k].iloc[:2]) for table in (was, now)))]
    deviations = []
    for name in dict.fromkeys((*was, *now)):
        if name not in was or name not in now:
            there = ("there", "not there") if name in was else ("not there", "there")
            deviations.append(_texts(file, name, len(was), "", *there))
        elif (differ := (was[name] != now[name]).to_numpy()).any():
            declared = next((column for column in columns(row_type) if column.matches(name)), None)
            deviations.append(_column(file, name, was, now, differ, declared))
    return deviations


def document_deviations(file: str, was: Any, now: Any) -> list[Deviation]:
    """Return the deviations between two documents, by dotted key."""
    first, second = _flat("", was), _flat("", now)
    deviations = []
    for key in dict.fromkeys((*first, *second)):
        before, other = first.get(key, "not there"), second.get(key, "not there")
        if before == other:
            continue
        if isinstance(before, NUMBERS) and isinstance(other, NUMBERS) and not isinstance(before, bool):
            largest = np.array(max(abs(before), abs(other)), dtype=float)
            whole = isinstance(before, int) and isinstance(other, int)
            scale = None if whole else float(_scale(largest, np.array(abs(other - before)), np.array(True)))
            deviations.append(_numbers(file, key, 1, "", float(before), float(other), "", scale, None))
        else:
            deviations.append(_texts(file, key, 1, "", str(before), str(other)))
    return deviations


def _sorted(table: pd.DataFrame) -> list[tuple[str, ...]]:
    return sorted(table.itertuples(index=False, name=None))


def _column(
    file: str, name: str, was: pd.DataFrame, now: pd.DataFrame, differ: np.ndarray, declared: Column | None
) -> Deviation:
    def texts(k: int) -> Deviation:
        return _texts(file, name, int(differ.sum()), str(was.iloc[k, 0]), was[name].iloc[k], now[name].iloc[k])

    if declared is None or declared.many or declared.kind not in NUMBERS:
        return texts(int(np.flatnonzero(differ)[0]))
    before, other = (pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float) for table in (was, now))
    apart = np.where(differ, np.abs(other - before), 0.0)
    if np.isnan(apart).any():  # a cell that is empty in one of the two
        return texts(int(np.flatnonzero(np.isnan(apart))[0]))
    units = _units(was, declared)
    larger = pd.Series(np.fmax(np.abs(before), np.abs(other)))
    scale = _scale(larger.groupby(units).transform("max").to_numpy(dtype=float), apart, np.isin(units, UNITLESS))
    k = int(np.argmax(np.divide(apart, scale, out=np.zeros_like(apart), where=scale > 0)))
    sd = pd.to_numeric(was[declared.sd], errors="coerce").to_numpy(dtype=float) if declared.sd in was else None
    in_sds = sd is not None and bool((sd[differ] > 0).any())
    in_sd = float(np.nanmax(apart[differ] / np.where(sd[differ] > 0, sd[differ], np.nan))) if in_sds else None  # type: ignore[index]
    rounds = None if declared.kind is int else float(scale[k])
    return _numbers(file, name, int(differ.sum()), str(was.iloc[k, 0]), before[k], other[k], units[k], rounds, in_sd)


def _scale(largest: np.ndarray, apart: np.ndarray, unitless: np.ndarray) -> np.ndarray:
    """The scale of each difference: at least 1 for unitless numbers, such as probabilities, that differ by rounding."""
    return np.where(unitless & (apart <= sys.float_info.epsilon), np.maximum(largest, 1.0), largest)


def _units(table: pd.DataFrame, declared: Column) -> np.ndarray:
    """The unit of the number in each row, since numbers in different units are not compared with each other."""
    stated = OF_ROW in declared.unit and "unit" in table
    return table["unit"].to_numpy(dtype=object) if stated else np.full(len(table), declared.unit, dtype=object)


def _numbers(
    file: str, name: str, cells: int, row: str, was: float, now: float, unit: str, scale: float | None, in_sd: float | None
) -> Deviation:  # fmt: skip
    apart, larger = abs(now - was), max(abs(was), abs(now))
    return Deviation(
        file=file, name=name, cells=cells, row=row, was=f"{was:.10g}", now=f"{now:.10g}", unit=unit, absolute=apart,
        relative=apart / larger if larger else 0.0, of_largest=apart / scale if scale else None, in_sd=in_sd,
    )  # fmt: skip


def _texts(file: str, name: str, cells: int, row: str, was: str, now: str) -> Deviation:
    return Deviation(file=file, name=name, cells=cells, row=row, was=was, now=now, unit="", absolute=None, relative=None,
                     of_largest=None, in_sd=None)  # fmt: skip


def _flat(key: str, value: Any) -> dict[str, Any]:
    """The values of a nested document by dotted key."""
    members = value.items() if isinstance(value, Mapping) else enumerate(value, 1) if isinstance(value, list) else None
    if members is None:
        return {key: value}
    return {k: v for name, member in members for k, v in _flat(f"{key}.{name}" if key else str(name), member).items()}
