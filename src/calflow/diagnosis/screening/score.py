"""A score: what one candidate would gain, as the screening tells it from a linearisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.regressors import Candidate


@dataclass(frozen=True)
class Score(Generic[H]):
    """What one candidate would gain, without a refit.

    drop is that of chi² and share its part of all, degrees_of_freedom those that it costs, p the p-value of this test
    alone; delta_bic is negative where it pays. visible_share is how much of the effect the model's own parameters cannot
    imitate, information S, shown how many directions of it the data show, left the degrees of freedom besides them. unusual is
    what delta_bic would lose if priors were taken for what they say (see `prior_cost`).
    """

    candidate: Candidate[H]
    drop: float
    share: float
    degrees_of_freedom: float
    p: float
    delta_bic: float
    visible_share: float
    estimate: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    shown: int
    left: float
    unusual: float = 0.0

    @property
    def explained(self) -> float:
        """Share of chi² that goes, not counting what the cause pulls at its own prior."""
        precision = np.linalg.inv(self.covariance)
        fallen = self.estimate @ (2 * precision - self.information) @ self.estimate
        return float(np.clip(fallen * self.share / max(self.drop, 1e-12), 0.0, 1 - 1e-6))

    @property
    def cause(self) -> H:
        """The cause."""
        return self.candidate.cause
