"""Base classes of touched objects (planes, balls, cubes, artefacts) of unknown pose, identified by a name in each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.files.deferred import pd
from calflow.observations.base import PLACE, OfThings
from calflow.robot.parts import UNKNOWN_BOUND, UNKNOWN_SD, Parameter


@dataclass(frozen=True)
class Touched(OfThings):
    """Rows of objects that the robot touches, by their name in the column `labelled_by`."""

    touches = True

    def place_errors(self, symbols: Sequence[str] = tuple(PLACE)) -> list[Parameter]:
        """Return the errors of each object's pose, in its own axes."""
        return [
            Parameter(self.id, self.part_of(name), symbol, PLACE[symbol], UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND,
                      meaning=f"{symbol} of {self.part_of(name)}")
            for name in self.names for symbol in symbols
        ]  # fmt: skip

    def first(self, n: int) -> np.ndarray:
        """Return the one-hot objects of n rows that are of the first one, (n_objects, n)."""
        places = np.zeros((len(self.names), n))
        places[0] = 1.0
        return places


@dataclass(frozen=True)
class Surface(Touched):
    """Heights of the marker over surfaces: a reading, or 0 for a marker on the surface where none is reported.

    The reading is the first of a row's `reported` values.
    """

    of_row = 1  # the reading

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings and the one-hot surfaces."""
        return np.vstack([self.readings(table), *self.which(table)]).astype(float)

    def readings(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings (n_rows,) [m]."""
        return table["reading"].to_numpy(float) if "reading" in table else np.zeros(len(table))

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the values expected on the surface itself: readings of zero."""
        expected = self.expected(points, rotations)
        expected[0] = 0.0
        return expected
