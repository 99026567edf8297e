"""Marker swap: two markers of one pose that were taken for each other."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import numpy as np

from calflow.faults.base import Check, Correction, Fault, fault
from calflow.faults.reference import Reference, lengths
from calflow.measurements.measurements import Measurements


class MarkerSwap(Check):
    """Exchange the positions of two markers where both rows are grossly off."""

    id: ClassVar[str] = "marker-swap"
    title: ClassVar[str] = "two markers were taken for each other"
    order: ClassVar[int] = 50

    def find(self, data: Measurements, reference: Reference) -> tuple[Fault, ...]:
        """Return one fault with all exchanged rows."""
        fit = reference.fit
        gross, miss = np.flatnonzero(reference.gross), reference.miss
        if len(gross) < 2 or data.table["marker"].nunique() < 2:
            return ()
        predicted, position = fit.predicted(data.conditions), data.position
        corrections: list[Correction] = []
        for _, group in data.table.iloc[gross].assign(row=gross).groupby(["pose", "repeat"], sort=False):
            pairs = [np.array(pair) for pair in combinations(group["row"], 2)]
            after = {k: lengths(position[pair[::-1]] - predicted[pair]) for k, pair in enumerate(pairs)}
            mended = [k for k, pair in enumerate(pairs) if fit.better(miss[pair], after[k]).all()]
            if len(mended) == 1:
                first, second = (int(row) + 1 for row in pairs[mended[0]])
                corrections += [Correction(first, source=second), Correction(second, source=first)]
        if not corrections:
            return ()
        markers = " and ".join(
            dict.fromkeys(data.table["marker"].iloc[[correction.row - 1 for correction in corrections]].astype(str))
        )
        statement = f"markers {markers} were taken for each other in LINES; exchanged, correct the file"
        return (fault(self, data, 0, corrections, "corrected", statement),)
