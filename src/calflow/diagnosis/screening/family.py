"""A family of tests: what the number of those that were made costs each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.diagnosis.screening.score import Score

BOOTSTRAP_SIGNIFICANCE = (
    0.05  # of the smallest p-value, at which the bootstrap counts how many tests the family is worth
)


@dataclass(frozen=True)
class Family:
    """What the number of tests costs: scans is how many each place's variants are worth, places all places together.

    A place pays for its own scan first, so that a cause without variants need not pay for the others'.
    """

    scans: dict[tuple[str, str], float]
    places: float

    def tests(self, score: Score) -> float:
        """Return how many tests a candidate pays for: its place's scan times all places."""
        return self.scans.get(score.cause.place, 1.0) * self.places

    def p(self, score: Score) -> float:
        """Return the chance that anything in the family looks like this where nothing is hidden."""
        return float(-np.expm1(self.tests(score) * np.log1p(-min(score.p, 1 - 1e-16))))


def worth(smallest: np.ndarray) -> float:
    """How many independent tests have a smallest p-value that is distributed like this, on the safe side of so few draws."""
    error = float(np.sqrt(BOOTSTRAP_SIGNIFICANCE * (1 - BOOTSTRAP_SIGNIFICANCE) / len(smallest)))
    quantile = float(np.quantile(smallest, BOOTSTRAP_SIGNIFICANCE - error))
    return float(max(1.0, np.log1p(-BOOTSTRAP_SIGNIFICANCE) / np.log1p(-min(quantile, BOOTSTRAP_SIGNIFICANCE))))
