"""The reference for faults of rows: the robust fit of a set-up, and each row's error against it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calflow.faults.rough import lengths
from calflow.faults.setup import FittedSetup, Setup
from calflow.measurements.measurements import Measurements

FAR_OFF = 0.01  # share of the measured space: a robust fit with a larger scale has failed
EQUATIONS = 2.4  # least equations per parameter: with fewer, some rows are fitted exactly and others look gross


@dataclass(frozen=True)
class Reference:
    """A robust fit to the rows of a data set; setup: theirs with all parameters, which the fit's may lack."""

    data: Measurements
    setup: Setup
    fit: FittedSetup

    @staticmethod
    def of(data: Measurements, setup: Setup) -> Reference | None:
        """Return the fit of the richest model of a set-up that the training rows determine; None if they are too few for any."""
        equations = 3 * len(np.unique(data.only(data.train).repeated))
        for candidate in (setup, setup.without_springs, setup.rigid):
            if EQUATIONS * (candidate.sd > 0).sum() <= equations:
                return Reference(data, setup, candidate.fitted)
        return None

    @cached_property
    def spread(self) -> float:
        """The size of the measured space [m]."""
        position = self.fit.setup.position
        return float(np.median(lengths(position - np.median(position, axis=0))))

    @property
    def plausible(self) -> bool:
        """Whether the fit succeeded."""
        return self.fit.scale < FAR_OFF * self.spread

    @cached_property
    def miss(self) -> np.ndarray:
        """The position error of each row, shape (n_rows,) [m] (see `FittedSetup.miss`)."""
        return self.fit.miss(self.data)

    @cached_property
    def gross(self) -> np.ndarray:
        """Which rows have gross errors, shape (n_rows,)."""
        return self.miss > self.fit.gross
