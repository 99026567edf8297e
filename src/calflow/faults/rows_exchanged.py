"""Rows exchanged: two positions that stand in each other's row, of two markers of one pose or of two poses."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, fault
from calflow.faults.reference import Reference
from calflow.faults.rough import lengths
from calflow.measurements.measurements import Measurements

MOST = 40  # rows that are grossly off, among which pairs of any poses are looked for
FEW = 2  # pairs of other poses: where there are more, rows are in disorder


class MarkerSwap(Check):
    """Exchange the positions of two markers where both rows are grossly off."""

    id: ClassVar[str] = "marker-swap"
    title: ClassVar[str] = "two markers were taken for each other"
    order: ClassVar[int] = 50

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault with all exchanged rows."""
        gross = data.table.iloc[np.flatnonzero(reference.gross)].assign(row=np.flatnonzero(reference.gross))
        groups = gross.groupby(["pose", "repeat"], sort=False)["row"]
        pairs = [pair for _, rows in groups for pair in _mended(data, reference, rows.to_numpy())]
        if not pairs:
            return ()
        markers = " and ".join(
            dict.fromkeys(data.table["marker"].iloc[[row for pair in pairs for row in pair]].astype(str))
        )
        statement = f"markers {markers} were taken for each other in LINES; exchanged, correct the file"
        return (fault(self, data, 0, _exchanged(pairs), "corrected", statement),)


class RowsExchanged(Check):
    """Exchange the positions of two poses where both rows are grossly off, and no others would mend them."""

    id: ClassVar[str] = "rows-exchanged"
    title: ClassVar[str] = "two rows were exchanged"
    order: ClassVar[int] = 15

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault with all exchanged rows."""
        gross = np.flatnonzero(reference.gross)
        if len(gross) > MOST:
            return ()
        pose = data.table["pose"].to_numpy()
        pairs = [(i, j) for i, j in _mended(data, reference, gross) if pose[i] != pose[j]]
        if not 0 < len(pairs) <= FEW:
            return ()
        statement = "positions stand in each other's row in LINES; exchanged, correct the file"
        return (fault(self, data, 0, _exchanged(pairs), "corrected", statement),)


def _mended(data: Measurements, reference: Reference, rows: np.ndarray) -> list[tuple[int, int]]:
    """Return the pairs of some rows that each other's position mends, where each of them has one such partner only."""
    pairs = np.array(list(combinations(rows, 2)), dtype=int).reshape(-1, 2)
    fit = reference.fit
    after = lengths(data.position[pairs[:, ::-1]] - fit.predicted(data.conditions)[pairs])
    found = pairs[fit.better(reference.miss[pairs], after).all(axis=1)]
    partners = np.bincount(found.ravel(), minlength=len(data))
    return [(int(i), int(j)) for i, j in found if partners[i] == partners[j] == 1]


def _exchanged(pairs: list[tuple[int, int]]) -> list[Correction]:
    return [Correction(row + 1, source=other + 1) for i, j in pairs for row, other in ((i, j), (j, i))]
