"""The extension of a robot's model by the causes that explain what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.exchange import verified
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.fitted_trial import FittedTrial, among
from calflow.diagnosis.search.linearisation import Detection, Linearisation, Screened
from calflow.diagnosis.search.stepwise import Stepwise
from calflow.diagnosis.search.trial import CauseAcceptance, Trial
from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit


@dataclass(frozen=True)
class Extended:
    """The extended model, its findings, the models that the search fitted, and the first screening."""

    fitted: Fitted
    findings: tuple[Detection[Cause], ...]
    trail: tuple[Fitted, ...]
    first: Screened[Cause]

    @cached_property
    def path(self) -> tuple[Fit, ...]:
        """The fits on the way, one a cause: those with the first causes, fitted where the search did not, and the last."""
        causes = self.fitted.causes
        shorter = [among(self.trail, causes[:k]) for k in range(1, len(causes))]
        return (*shorter, self.fitted.fit) if causes else ()

    def weighed(self, sigma: np.ndarray) -> Extended:
        """Fit the extended model anew with another noise (n_rows,) [m] of the rows."""
        return replace(self, fitted=self.fitted.weighed(sigma))


def extend(
    start: Fitted,
    catalogue: Catalogue,
    acceptance: CauseAcceptance,
    rng: np.random.Generator,
    say: Callable[[str], None],
    advance: Callable[[float], None] = lambda share: None,
) -> Extended:
    """Add causes while one is accepted, and drop, swap and exchange those that prove mistaken, until nothing changes.

    say is told each step in words, advance the share of the search that is done, which never falls.
    """
    first = Linearisation.at(start, catalogue).screened(rng)
    ended = Stepwise(acceptance, first, rng, say, advance).best(FittedTrial(first.family, start, catalogue))
    return extended(*ended, first)


def extended(found: Trial[Cause], every: list[Trial[Cause]], first: Screened[Cause]) -> Extended:
    """Return what a search ended with, found being its best trial of every one."""
    best, tried = cast(tuple[FittedTrial, list[FittedTrial]], (found, every))  # trials lead to trials of their own kind
    trail = tuple(trial.fitted for trial in tried)
    return Extended(best.fitted, verified(best, tried), trail, first)


def weighed_against(extension: Extended, catalogue: Catalogue) -> Extended:
    """Score a wider catalogue's candidates in each cause's place: what was left out of the search can still be the truth."""
    if not extension.findings:
        return extension
    return replace(extension, findings=FittedTrial(extension.first.family, extension.fitted, catalogue).findings)
