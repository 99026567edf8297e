"""Trials: candidates tested against many residuals at once, as a simulation asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from calflow.diagnosis.screening.hypothesis import H


@dataclass(frozen=True, eq=False)
class Trials(Generic[H]):
    """Visible candidates, the BIC that each would gain (n_candidates, n_draws), and whether it would be found, likewise."""

    causes: tuple[H, ...]
    bic: np.ndarray
    passed: np.ndarray

    def by_place(self) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
        """Return each place's BIC (n_draws,), averaged over its variants as evidence is, and whether any would be found."""
        members: dict[tuple[str, str], list[int]] = {}
        for k, cause in enumerate(self.causes):
            members.setdefault(cause.place, []).append(k)
        return {
            place: (-2 * np.logaddexp.reduce(-self.bic[own] / 2, axis=0), np.asarray(self.passed[own].any(axis=0)))
            for place, own in members.items()
        }
