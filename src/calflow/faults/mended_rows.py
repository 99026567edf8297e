"""Mended rows: rows that are grossly off, and that one definite change, and no other, brings back among the others.

A position in metres among millimetres, a reading in radians among degrees, or two positions that stand in each other's row, of two
markers of one pose or of two poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import combinations

import numpy as np

from calflow.faults.base import POSITION, Check, Correction, Fault, fault
from calflow.faults.reference import Reference
from calflow.faults.rough import Rough, lengths, rows_with_reading
from calflow.measurements.measurements import Measurements

LENGTHS = ((1e3, "m instead of mm"), (1e-3, "mm instead of m"), (25.4, "inches instead of mm"))
ANGLES = ((180 / np.pi, "radians instead of degrees"), (np.pi / 180, "degrees instead of radians"))
MOST = 40  # rows that are grossly off, among which pairs of any poses are looked for
FEW = 2  # pairs of other poses: where there are more, rows are in disorder


@partial(Check, "unit-mistake", 40)
def unit_mistake(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Try the other units in rows that are grossly off.

    It is a fault a joint, or for the positions, and kind of mistake; a row that two units would mend is left alone.
    """
    rows, faults = np.flatnonzero(reference.gross), []
    tried = list(_other_units(data, reference.fit, rows))
    better = np.stack([reference.fit.better(reference.miss[rows], after) for *_, after in tried])
    only = better & (better.sum(axis=0) == 1)
    for (joint, factor, what, _), mended in zip(tried, only, strict=True):
        where, quantity = (f"joint {joint}: the reading is", f"q{joint}") if joint else ("x, y, z are", POSITION)
        factor = float(f"{factor:.10g}")  # as the table will say it
        corrections = [Correction(int(row) + 1, quantity, factor) for row in rows[mended]]
        if corrections:
            statement = f"{where} in {what} in LINES; corrected in memory; correct the file, too"
            faults.append(fault(unit_mistake.id, data, joint, corrections, "corrected", statement))
    return tuple(faults)


@partial(Check, "marker-swap", 50)
def marker_swap(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Exchange the positions of two markers where both rows are grossly off: one fault with all exchanged rows."""
    gross = data.table.iloc[np.flatnonzero(reference.gross)].assign(row=np.flatnonzero(reference.gross))
    groups = gross.groupby(["pose", "repeat"], sort=False)["row"]
    pairs = [pair for _, rows in groups for pair in _mended(data, reference, rows.to_numpy())]
    if not pairs:
        return ()
    markers = dict.fromkeys(data.table["marker"].iloc[[row for pair in pairs for row in pair]].astype(str))
    statement = f"markers {' and '.join(markers)} were taken for each other in LINES; exchanged, correct the file"
    return (fault(marker_swap.id, data, 0, _exchanged(pairs), "corrected", statement),)


@partial(Check, "rows-exchanged", 15)
def rows_exchanged(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Exchange the positions of two poses where both rows are grossly off, and no others would mend them: one fault with all."""
    gross, pose = np.flatnonzero(reference.gross), data.table["pose"].to_numpy()
    pairs = _mended(data, reference, gross) if len(gross) <= MOST else []
    pairs = [(i, j) for i, j in pairs if pose[i] != pose[j]]
    if not 0 < len({(pose[i], pose[j]) for i, j in pairs}) <= FEW:
        return ()
    statement = "positions stand in each other's row in LINES; swapped back, correct the file"
    return (fault(rows_exchanged.id, data, 0, _exchanged(pairs), "corrected", statement),)


def _other_units(data: Measurements, fit: Rough, rows: np.ndarray) -> Iterator[tuple[int, float, str, np.ndarray]]:
    """Yield joint (0: positions), factor, the mistake in words, and the rows' errors (n_rows,) [m] without it."""
    position, predicted = data.position[rows], fit.predicted(data.conditions[:, rows])
    for factor, what in LENGTHS:
        yield 0, factor, what, lengths(factor * position - predicted)
    for i, joint in enumerate(data.robot.joints):
        if joint.kind == "revolute":
            for factor, what in ANGLES:
                read = rows_with_reading(data, i, factor * data.joints[rows, i], rows)
                yield i + 1, factor, what, lengths(position - fit.predicted(read))


def _mended(data: Measurements, reference: Reference, rows: np.ndarray) -> list[tuple[int, int]]:
    """Return the pairs of some rows that each other's position mends, where each of them has one such partner only.

    Of a pose that was measured several times any repeat mends a row: then its partner is the same repeat at the same marker.
    """
    pairs = np.array(list(combinations(rows, 2)), dtype=int).reshape(-1, 2)
    if not len(pairs):
        return []
    fit = reference.fit
    after = lengths(data.position[pairs[:, ::-1]] - fit.predicted(data.conditions)[pairs])
    better = pairs[fit.better(reference.miss[pairs], after).all(axis=1)]
    if np.bincount(better.ravel()).max(initial=0) > 1:
        repeat, marker = (data.table[name].to_numpy()[better] for name in ("repeat", "marker"))
        better = better[(repeat[:, 0] == repeat[:, 1]) & (marker[:, 0] == marker[:, 1])]
    partners = np.bincount(better.ravel(), minlength=len(data))
    return [(int(i), int(j)) for i, j in better if partners[i] == partners[j] == 1]


def _exchanged(pairs: list[tuple[int, int]]) -> list[Correction]:
    return [Correction(row + 1, source=other + 1) for i, j in pairs for row, other in ((i, j), (j, i))]
