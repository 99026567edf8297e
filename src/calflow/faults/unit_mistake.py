"""Unit mistake: rows with a position in metres among millimetres, or a reading in radians among degrees."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from calflow.faults.base import POSITION, Check, Correction, Fault, fault
from calflow.faults.reference import Reference
from calflow.faults.rough import Rough, lengths, rows_with_reading
from calflow.measurements.measurements import Measurements

LENGTHS = ((1e3, "m instead of mm"), (1e-3, "mm instead of m"))
ANGLES = ((180 / np.pi, "radians instead of degrees"), (np.pi / 180, "degrees instead of radians"))


class UnitMistake(Check):
    """Try the other units in rows that are grossly off."""

    id: ClassVar[str] = "unit-mistake"
    title: ClassVar[str] = "some rows are in another unit"
    order: ClassVar[int] = 40

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return a fault a joint, or for the positions, and kind of mistake; a row that two units would mend is left alone."""
        fit = reference.fit
        rows = np.flatnonzero(reference.gross)
        if not len(rows):
            return ()
        tried = list(_tried(data, fit, rows))
        better = np.stack([fit.better(reference.miss[rows], after) for *_, after in tried])
        only = better & (better.sum(axis=0) == 1)
        return tuple(
            self._fault(data, joint, rows[mask], factor, what)
            for (joint, factor, what, _), mask in zip(tried, only, strict=True)
            if mask.any()
        )

    def _fault(self, data: Measurements, joint: int, rows: np.ndarray, factor: float, what: str) -> Fault:
        where, quantity = (f"joint {joint}: the reading", f"q{joint}") if joint else ("x, y, z", POSITION)
        verb = "is" if joint else "are"
        statement = f"{where} {verb} in {what} in LINES; corrected so, correct the file"
        factor = float(f"{factor:.10g}")  # as the table will say it
        return fault(
            self, data, joint, [Correction(int(row) + 1, quantity, factor) for row in rows], "corrected", statement
        )


def _tried(data: Measurements, fit: Rough, rows: np.ndarray) -> Iterator[tuple[int, float, str, np.ndarray]]:
    """Yield joint (0: positions), factor, the mistake in words, and the rows' errors (n_rows,) [m] without it."""
    position, predicted = data.position[rows], fit.predicted(data.conditions[:, rows])
    for factor, what in LENGTHS:
        yield 0, factor, what, lengths(factor * position - predicted)
    for i, joint in enumerate(data.robot.joints):
        if joint.kind == "revolute":
            for factor, what in ANGLES:
                read = rows_with_reading(data, i, factor * data.joints[rows, i], rows)
                yield i + 1, factor, what, lengths(position - fit.predicted(read))
