"""The reference for faults of rows: the rough robot of a set-up, and how far each row is from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calflow.estimation.noise import conditions
from calflow.faults.rough import Rough, lengths
from calflow.faults.setup import ExplainedSetup, Setup
from calflow.measurements.measurements import Measurements

FAR_OFF = 0.01  # share of the measured space from which a robust fit's scale says that it found no robot at all
EQUATIONS = 2.4  # a parameter: with fewer some rows are met exactly whatever they hold, and others look gross


@dataclass(frozen=True)
class Reference:
    """What the rows of a data set say of one another; setup is theirs with all that may move, explained that of which it is."""

    data: Measurements
    setup: Setup
    explained: ExplainedSetup

    @staticmethod
    def of(data: Measurements, setup: Setup | None = None) -> Reference | None:
        """Fit the richest robot that the training rows are enough for, None where there is only a handful.

        setup is that of these rows, and need not be built again.
        """
        setup = setup or Setup.of(data)
        equations = 3 * len(np.unique(conditions(data.only(data.train))))
        for candidate in (setup, setup.without_springs, setup.rigid):
            if EQUATIONS * (candidate.expected.sd > 0).sum() <= equations:
                return Reference(data, setup, candidate.explained)
        return None

    @property
    def fit(self) -> Rough:
        """The rough robot."""
        return self.explained.fit

    @cached_property
    def spread(self) -> float:
        """The size of the measured space [m]."""
        position = self.explained.setup.position
        return float(np.median(lengths(position - np.median(position, axis=0))))

    @property
    def plausible(self) -> bool:
        """Whether the fit found a robot at all."""
        return self.fit.scale < FAR_OFF * self.spread

    @cached_property
    def miss(self) -> np.ndarray:
        """How far each row is from where the fit says it should be, shape (n_rows,) [m]."""
        return self.fit.miss(self.data)

    @cached_property
    def gross(self) -> np.ndarray:
        """Which rows are gross, shape (n_rows,)."""
        return self.miss > self.fit.gross
