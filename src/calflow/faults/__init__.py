"""Data faults: gross mistakes in the measurements, looked for before any fit, one kind per file."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, reduce
from pathlib import Path
from typing import TypeVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, FaultyRow, PlainCheck, correct
from calflow.faults.implausible import nominal_misfit, past_limits
from calflow.faults.outlier import gross_rows, is_position
from calflow.faults.reference import Reference
from calflow.faults.setup import Setup
from calflow.faults.setup_search import setup_faults
from calflow.files.deferred import pd
from calflow.files.problems import Problem, refuse, refuse_any
from calflow.files.tables import from_frame, to_frame
from calflow.measurements.measurements import Measurements

__all__ = [
    "Check", "Correction", "Fault", "FaultyRow", "PlainCheck", "as_table", "checks", "corrected", "examined", "plain_checks",
    "search_faults",
]  # fmt: skip
AnyCheck = TypeVar("AnyCheck", Check, PlainCheck)


@lru_cache
def checks() -> tuple[Check, ...]:
    """Return every check against a rough robot in its order; a new file in this folder is enough to add one."""
    return _found(Check)


@lru_cache
def plain_checks() -> tuple[PlainCheck, ...]:
    """Return every check of the rows by themselves in its order; a new file in this folder is enough to add one."""
    return _found(PlainCheck)


def _found(kind: type[AnyCheck]) -> tuple[AnyCheck, ...]:
    modules = [importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    here = {check for module in modules for check in vars(module).values() if isinstance(check, kind)}
    return tuple(sorted(here, key=lambda check: check.order))


def examined(data: Measurements, paths: Sequence[Path] = ()) -> tuple[Measurements, tuple[Fault, ...]]:
    """Return what `search` does of measurements from these files, one a series (none: from arrays).

    Raises:
        InputError: what is left cannot be of this robot: poses past its limits, or positions far from where it can be.
    """
    data, faults, setup = _searched(data)
    problems: list[Problem] = []
    for past, message in past_limits(data):
        series = data.series_number[past]
        problems += [Problem(message, paths[k] if paths else None) for k in dict.fromkeys(map(int, series))]
    if problems:  # what nobody has settled may be why
        problems = [*(Problem(fault.statement) for fault in faults if fault.action == "unsettled"), *problems]
    if not problems and setup and (message := nominal_misfit(setup)):
        first = int(data.series_number[is_position(data)][0])
        problems.append(Problem(message, paths[first] if paths else None))
    refuse_any(problems)
    return data, faults


def search_faults(data: Measurements) -> tuple[Measurements, tuple[Fault, ...]]:
    """Return the rows as the fits are to see them, and what was wrong with them.

    What has one clear correction is corrected; rows that nothing puts right are left out of fit and judgement. A mistake of robot
    file or whole table comes first: where it is unsettled, nothing is said of rows.

    Raises:
        InputError: robot file or table have a mistake that no fit mends.
    """
    data, faults, _ = _searched(data)
    return data, faults


def _searched(data: Measurements) -> tuple[Measurements, tuple[Fault, ...], Setup | None]:
    """Return the rows and their faults, and the set-up of those rows that have positions, if there are any."""
    faults: list[Fault] = []
    for check in plain_checks():
        faults += (found := check.find(data))
        data = reduce(correct, found, data)
    positions, setup = is_position(data), None
    if positions.all():
        data, position_faults, setup = _of_positions(data)
        return data, (*faults, *position_faults), setup
    if positions.any():
        _, position_faults, setup = _of_positions(data.only(positions))
        faults += (moved := [fault.among(np.flatnonzero(positions)) for fault in position_faults])
        data = reduce(correct, moved, data)
    gross = gross_rows(data, ~positions)
    return reduce(correct, gross, data), (*faults, *gross), setup


def _of_positions(data: Measurements) -> tuple[Measurements, tuple[Fault, ...], Setup]:
    setup = Setup.of(data)
    faults = [*setup_faults(data, setup)]
    data = reduce(correct, faults, data)
    setup = setup.on(data) if faults else setup
    reference = Reference.of(data, setup)
    for check in checks():
        if any(fault.action == "unsettled" for fault in faults):
            break
        if detected := check.find(data, reference) if reference else ():
            data = reduce(correct, detected, data)
            faults += detected
            setup = setup.on(data)
            reference = Reference.of(data, setup)
    return data, tuple(faults), setup


def as_table(faults: Sequence[Fault], data: Measurements) -> pd.DataFrame:
    """Return identify/faults.csv: a row a faulty line of the file, or one without a line for a whole column."""
    return to_frame([row for fault in faults for row in fault.rows(data)], FaultyRow)


def corrected(data: Measurements, table: pd.DataFrame) -> Measurements:
    """Return freshly read rows as identify saw them, by the table that it wrote; nothing is searched for again.

    Raises:
        InputError: the table is about other rows.
    """
    if not len(table):
        return data
    faults: dict[Fault, list[Correction]] = {}
    lines = data.table["line"].to_numpy()
    for row in from_frame(table, FaultyRow, "identify/faults.csv"):
        there = 0 <= row.row <= len(data) and row.source <= len(data)
        if not there or (row.row and lines[row.row - 1] != row.line):
            raise refuse("identify/faults.csv does not fit the measurements; run identify again")
        correction = Correction(row.row, row.quantity, row.factor, row.offset, row.source)
        faults.setdefault(Fault(row.cause, row.joint, (), row.statement, row.action), []).append(correction)
    return reduce(correct, (replace(fault, corrections=tuple(made)) for fault, made in faults.items()), data)
