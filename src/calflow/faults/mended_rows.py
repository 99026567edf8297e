"""Mended rows: gross outliers that exactly one definite correction brings into agreement with the other rows.

A position in metres or inches among millimetres, a reading or all of a row in radians among degrees, or two exchanged
positions, of two markers of one pose or of two poses.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from calflow.faults.base import Correction, Fault, fault
from calflow.faults.mistake import row_mistakes
from calflow.faults.reference import Reference
from calflow.faults.rough import lengths
from calflow.measurements.measurements import Measurements

MAX_GROSS_ROWS = 40  # largest number of gross rows among which pairs of any poses are sought
MAX_PAIRS = 2  # largest number of pairs of different poses: with more, rows are in disorder


def unit_mistake(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return faults of gross outliers that another unit corrects.

    There is one fault per joint, or for the positions, and unit; a row that two units would correct is left alone.
    """
    rows, faults = np.flatnonzero(reference.gross & reference.plausible), []
    there, fit = reference.setup.at(data, rows), reference.fit
    tried = [mistake for mistake in row_mistakes(data) if mistake.id == "unit-mistake"]
    undone = [mistake.undo(there) for mistake in tried]
    after = np.stack([fit.errors_at(setup) for setup in undone])
    better = fit.better(reference.miss[rows], after)
    only = better & (better.sum(axis=0) == 1)
    for mistake, mended in zip(tried, only, strict=True):
        corrections = [replace(made, row=int(row) + 1) for row in rows[mended] for made in mistake.in_rows]
        if corrections:
            statement = f"{mistake.words} in LINES; corrected for this run only; correct the file, too"
            faults.append(fault("unit-mistake", data, mistake.joint, corrections, "corrected", statement))
    return tuple(faults)


def exchanged(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return faults of exchanged positions, if both rows are gross outliers with no other partner: one fault per kind.

    Exchanges of two markers are sought in any number of poses, those of two poses only among few outliers.
    """
    gross, pose = np.flatnonzero(reference.gross), data.table["pose"].to_numpy()
    groups = data.table.iloc[gross].assign(row=gross).groupby(["pose", "repeat"], sort=False)["row"]
    swaps = [pair for _, rows in groups for pair in _mended(data, reference, rows.to_numpy())]
    others = np.setdiff1d(gross, swaps)
    pairs = _mended(data, reference, others) if len(others) <= MAX_GROSS_ROWS else []
    pairs = [(i, j) for i, j in pairs if pose[i] != pose[j]]
    if len({(pose[i], pose[j]) for i, j in pairs}) > MAX_PAIRS:
        pairs = []
    markers = dict.fromkeys(data.table["marker"].iloc[[row for pair in swaps for row in pair]].astype(str))
    swapped = (
        f"markers {' and '.join(markers)} are exchanged in LINES; corrected for this run only; correct the file, too"
    )
    moved = "positions of pairs of rows are exchanged in LINES; corrected for this run only; correct the file, too"
    return (*_exchange(data, "marker-swap", swaps, swapped), *_exchange(data, "rows-exchanged", pairs, moved))


def _exchange(data: Measurements, cause: str, pairs: list[tuple[int, int]], statement: str) -> tuple[Fault, ...]:
    """Return the fault that the positions of each pair of rows are exchanged; none without a pair."""
    corrections = [Correction(row + 1, source=other + 1) for i, j in pairs for row, other in ((i, j), (j, i))]
    return (fault(cause, data, 0, corrections, "corrected", statement),) if pairs else ()


def _mended(data: Measurements, reference: Reference, rows: np.ndarray) -> list[tuple[int, int]]:
    """Return the pairs of rows that an exchange of positions corrects, if each row has only one such partner.

    With repeated poses any repeat would correct a row: the partner is then the same repeat at the same marker.
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
