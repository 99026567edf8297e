"""Data faults: gross mistakes in the measurements, detected before any fit, one kind per file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from calflow.faults.base import Correction, Fault, FaultyRow, correct
from calflow.faults.duplicate import duplicate
from calflow.faults.encoder_turn import encoder_turn
from calflow.faults.implausible import lengths_in_other_units, nominal_misfit, one_position, past_limits
from calflow.faults.measured_torque import measured_torque
from calflow.faults.mended_rows import exchanged, unit_mistake
from calflow.faults.outlier import gross_rows, is_position, outlier
from calflow.faults.photographed import mistake_of_images
from calflow.faults.reference import Reference
from calflow.faults.repeats import odd_repeats
from calflow.faults.row_misalignment import lost_rows, row_misalignment
from calflow.faults.setup import Setup
from calflow.faults.setup_search import setup_faults
from calflow.faults.stated_lens import stated_lens
from calflow.files.deferred import pd
from calflow.files.problems import Problem, refuse, refuse_any
from calflow.files.tables import from_frame, to_frame
from calflow.measurements.measurements import Measurements

__all__ = ["CHECKS", "PLAIN_CHECKS", "Correction", "Fault", "FaultyRow", "as_table", "corrected", "examined"]

# Checks for one kind of fault each, in order, each on the rows corrected by those before: first of rows by themselves,
# then of positions against a robust fit.
PLAIN_CHECKS: tuple[Callable[[Measurements], tuple[Fault, ...]], ...] = (duplicate, measured_torque, stated_lens)
Check = Callable[[Measurements, Reference], tuple[Fault, ...]]
DEFINITE_CHECKS: tuple[Check, ...] = (exchanged, row_misalignment, encoder_turn, unit_mistake)
CHECKS: tuple[Check, ...] = (*DEFINITE_CHECKS, setup_faults, lost_rows, outlier)


@threadpool_limits.wrap(limits=1, user_api="blas")  # an arm's matrices are too small for threads to pay
def examined(data: Measurements, paths: Sequence[Path] = ()) -> tuple[Measurements, tuple[Fault, ...]]:
    """Return the rows with faults corrected or excluded, and the faults; paths: the series' files (none: from arrays).

    A fault with a unique correction is corrected; other faulty rows are excluded from fit and evaluation. Rows with a
    definite correction come first, then a mistake of robot file, table or set-up: while it is unsettled, no row is
    excluded.

    Raises:
        InputError: a mistake of robot file or table that no fit can absorb, or rows that this robot cannot have
            produced: poses beyond its limits, or positions far out of its reach.
    """
    data, faults, setup = _searched(data)

    def problems_of(rows: np.ndarray, message: str) -> list[Problem]:
        series = dict.fromkeys(data.series_number[rows].tolist())
        return [Problem(message, paths[k] if paths else None) for k in series]

    problems = [problem for rows, message in past_limits(data) for problem in problems_of(rows, message)]
    if problems:  # possible reasons: an unsettled mistake, or a joint whose readings were all corrected
        why = [fault for fault in faults if fault.action == "unsettled" or (fault.joint and not fault.lines)]
        problems = [*(Problem(fault.statement) for fault in why), *problems]
    elif setup and (message := nominal_misfit(setup)):
        problems = problems_of(np.flatnonzero(is_position(data))[:1], message)
    elif "length" in data.table and not unsettled(faults):
        others = lengths_in_other_units(data)
        problems = [problem for rows, message in others for problem in problems_of(rows, message)]
    refuse_any(problems)
    return data, faults


def _searched(data: Measurements) -> tuple[Measurements, tuple[Fault, ...], Setup | None]:
    """Return the rows and their faults, and the set-up of the rows with positions, if any."""
    faults, setup = list[Fault](), None

    def correcting(found: Sequence[Fault]) -> Measurements:
        faults.extend(found)
        return reduce(correct, found, data)

    for check in PLAIN_CHECKS:
        data = correcting(check(data))
    positions = is_position(data)
    if positions.any():
        if message := one_position(data.position[positions]):
            raise refuse(message)
        found, setup = _of_positions(data.only(positions))
        data = correcting([fault.in_all_rows(np.flatnonzero(positions)) for fault in found])
    else:
        data = correcting(mistake_of_images(data))
    if not positions.all() and not unsettled(faults):
        data = correcting(gross_rows(data, ~positions))
    if not unsettled(faults):
        data = correcting(odd_repeats(data))
    return data, tuple(faults), setup


def _of_positions(data: Measurements) -> tuple[list[Fault], Setup | None]:
    """Return the faults of rows with positions, and the set-up of the rows without them; none if none is fitted."""
    if not data.train.any():
        return [], None
    setup, faults, checks = Setup.of(data), list[Fault](), [*CHECKS]
    reference = Reference.of(data, setup)
    while checks and reference and not unsettled(faults):
        check = checks.pop(0)
        if detected := check(data, reference):
            data = reduce(correct, detected, data)
            faults += detected
            setup = setup.on(data)
            reference = Reference.of(data, setup)
            if check is setup_faults:  # what it corrected may have hidden what corrects single rows
                checks = [*DEFINITE_CHECKS, *checks]
    return faults, setup


def unsettled(faults: Sequence[Fault]) -> bool:
    """Return whether the user must settle one of the faults."""
    return any(fault.action == "unsettled" for fault in faults)


def as_table(faults: Sequence[Fault], data: Measurements) -> pd.DataFrame:
    """Return identify/faults.csv: a row per faulty line of the file, or one without a line for a whole column."""
    return to_frame([row for fault in faults for row in fault.rows(data)], FaultyRow)


def corrected(data: Measurements, table: pd.DataFrame) -> Measurements:
    """Return freshly read rows corrected by the table that identify wrote, without a new search.

    Raises:
        InputError: the table refers to other rows.
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
