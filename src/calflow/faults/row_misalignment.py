"""Row misalignment: from some row on, positions are shifted by rows against the readings."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

import numpy as np

from calflow.faults.base import Correction, Fault, correct, fault, faulty_rows
from calflow.faults.reference import Reference
from calflow.faults.rough import motion, rigid_errors, rigid_sums, split_errors
from calflow.faults.segments import state_cost, states
from calflow.faults.setup import FittedSetup, Setup
from calflow.measurements.measurements import Measurements

BEGINNINGS = 3000  # largest number of rows tried as the beginning of a shift, which is refined afterwards
MIN_SHIFTED_ROWS = 3  # least number of shifted rows
CHANGE = 25.0  # cost of a change of shift: about two rows with errors of a metre, so that two exchanged rows are none
HALVED = 0.5  # a shift is fitted if it reduces the nominal robot's error to this share
MIN_IMPROVED_SHARE = 0.8  # least share of the shifted rows that must become far better
BLOCK = 5  # consecutive poses with large errors, which no robot has
FAR_ROW = 0.05  # least error of such a row, as a share of the measured space
MAX_BLOCK_SHARE = 1 / 3  # largest share of rows in such blocks


def row_misalignment(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return the faults of rows whose positions belong to other rows' readings, realigned, and of rows without a partner."""
    if reference.plausible and reference.gross.sum() < MIN_SHIFTED_ROWS:
        return ()
    lags = _lags(data)
    guess = _initial_sources(data, reference.fit.setup, lags)
    moved = None if guess is None else reduce(correct, _shifted(data, guess), data)
    again = None if moved is None else Reference.of(moved, reference.fit.setup.on(moved))
    references = [other for other in (reference, again) if other and other.plausible]
    alignments = [alignment for other in references for alignment in _realigning(data, other.fit, lags)]
    if not alignments:
        return ()
    _, source = min(alignments, key=lambda alignment: alignment[0])
    return _shifted(data, source)


def _shifted(data: Measurements, source: np.ndarray) -> tuple[Fault, ...]:
    realigned = np.flatnonzero((source != np.arange(len(data))) & (source >= 0))
    by = float(np.median(source[realigned] - realigned)) if len(realigned) else 0.0
    where = "too early" if by < 0 else "too late"
    rows = "a row" if abs(by) == 1 else f"{abs(int(by))} rows"
    statement = (
        f"positions are {rows} {where} against the readings (LINES): a row was lost or written twice where that begins; "
        "realigned for this run only; correct the file, too"
    )
    corrections = [Correction(int(row) + 1, source=int(source[row]) + 1) for row in realigned]
    faults = [fault("row-misalignment", data, 0, corrections, "corrected", statement)]
    alone = np.flatnonzero(source < 0)
    if len(alone):
        lost = "no position belongs to these readings (LINES), since positions are shifted; left out"
        faults.append(faulty_rows("row-misalignment", data, alone, "left out", lost))
    return tuple(faults)


def lost_rows(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return the fault of blocks of rows whose positions match no readings, and no motion of the device; to be left out."""
    fit = reference.fit
    if not reference.plausible:
        return ()
    predicted, position, pose = fit.predicted(data.conditions), data.position, data.table["pose"].to_numpy()
    far = reference.miss > max(FAR_ROW * reference.spread, fit.gross)
    rows: list[int] = []
    for block in np.split(np.arange(len(far)), np.flatnonzero(far[1:] != far[:-1]) + 1):
        if far[block[0]] and len(set(pose[block])) >= BLOCK:
            moved = np.median(motion(predicted[block], position[block])[2]) < fit.gross
            rows += [] if moved else block.tolist()
    if not 0 < len(rows) <= MAX_BLOCK_SHARE * len(far):
        return ()
    statement = (
        "positions and readings do not belong together (LINES), and no shift of the rows corrects that; left out; "
        "check how these rows came into the file"
    )
    return (faulty_rows("row-misalignment", data, rows, "left out", statement),)


def _lags(data: Measurements) -> list[int]:
    """Return the possible shifts of positions in rows: one row, one line of the file, or one pose."""
    sizes = {1}
    for label in ("line", "pose"):
        counts = data.table.groupby(label, sort=False).size()
        sizes.add(int(counts.iloc[0]) if counts.nunique() == 1 else 1)
    return [lag for size in sorted(sizes) for lag in (size, -size)]


def _realigning(data: Measurements, fit: FittedSetup, lags: list[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the remaining number of gross rows, and the row of each reading's position (n_rows,), -1 if none.

    Nothing is yielded if shifted rows do not explain the data.
    """
    miss = fit.miss(data)
    if (miss > fit.gross).sum() < MIN_SHIFTED_ROWS:
        return
    predicted, position = fit.predicted(data.conditions), data.position
    costs = np.stack(
        [state_cost(np.linalg.norm(position - _lagged(predicted, lag), axis=1), fit.scale) for lag in (0, *lags)]
    )
    source = _sources(np.array([0, *lags])[states(costs, CHANGE)])
    partnered = np.flatnonzero((source != np.arange(len(data))) & (source >= 0))
    misaligned = partnered[miss[partnered] > fit.gross]  # repeats shifted by a row are wrong only at each pose's last
    if len(misaligned) < MIN_SHIFTED_ROWS:
        return
    after = fit.miss(reduce(correct, _shifted(data, source), data))
    better = fit.better(miss[misaligned], after[misaligned]).mean() >= MIN_IMPROVED_SHARE
    if better and (after[partnered] < fit.gross).mean() >= MIN_IMPROVED_SHARE:
        yield int((after > fit.gross).sum()), source


def _sources(lag: np.ndarray) -> np.ndarray:
    """Return the row of each reading's position (n_rows,), -1 if none, from each position's shift to its reading (n_rows,)."""
    n = len(lag)
    source = np.full(n, -1)
    for row in np.argsort(lag == 0, kind="stable"):  # positions in place come last and win
        if 0 <= row + lag[row] < n:
            source[row + lag[row]] = row
    return source


def _lagged(values: np.ndarray, lag: int) -> np.ndarray:
    """Return values (n_rows, 3) shifted by a number of rows; nan beyond the ends."""
    shifted = np.full_like(values, np.nan)
    n = len(values)
    shifted[max(0, -lag) : min(n, n - lag)] = values[max(0, lag) : min(n, n + lag)]
    return shifted


def _initial_sources(data: Measurements, setup: Setup, lags: list[int]) -> np.ndarray | None:
    """Return the sources of one shift, before or after one row, that best aligns the nominal robot; None if poorly.

    All rows are tried at once: the error of the best rigid motion follows from sums over the rows before and after.
    Held-out rows are used only to match rows.
    """
    points, measured = setup.model.position(setup.mean, data.conditions), data.position
    middle = np.median(measured, axis=0)
    points, measured = points - np.nanmedian(points, axis=0), measured - middle
    plain = rigid_sums(points, measured)
    whole = rigid_errors(plain.sum(axis=0))
    best, lag, every = whole, np.zeros(len(data), dtype=int), np.arange(len(data))
    tried = every[:: -(-len(data) // BEGINNINGS)]
    for by in lags:
        for later, errors in enumerate(split_errors(plain, rigid_sums(_lagged(points, by), measured), tried)):
            k = int(errors.argmin())
            if errors[k] < best:
                best, lag = errors[k], np.where((every > tried[k]) == later, by, 0)
    return _sources(lag) if best < HALVED**2 * whole else None
