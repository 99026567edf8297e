"""A look at a fitted model: every candidate beside it, or in the place of a cause that it has, from one linearisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.regressors import Regressors
from calflow.diagnosis.screening.screening import Family, Score, Screening
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause


@dataclass(frozen=True)
class Finding:
    """A cause in the extended model, with all candidates' scores where it is taken out and the others stay."""

    cause: Cause
    scores: tuple[Score, ...]
    family: Family

    @property
    def own(self) -> Score:
        """The cause's own score."""
        return next(score for score in self.scores if score.cause == self.cause)

    @property
    def p(self) -> float:
        """The chance that anything in the family looks like this where nothing is hidden."""
        return self.family.p(self.own)


@dataclass(frozen=True)
class Screened:
    """All candidates' scores against one model, best first, what their number costs, and which places cannot be seen."""

    scores: tuple[Score, ...]
    family: Family
    hidden: tuple[Cause, ...]


@dataclass(frozen=True)
class Linearisation:
    """One model with causes, and all candidates' regressors there, from one Jacobian."""

    fitted: Fitted
    regressors: Regressors

    @staticmethod
    def at(fitted: Fitted, catalogue: Catalogue) -> Linearisation:
        """Linearise a fitted model; its own causes are among the candidates, for when they are taken out."""
        own = (cause for cause in fitted.causes if cause.effect not in catalogue.effects)
        return Linearisation(
            fitted, Regressors.of(fitted.fit, fitted.problem, (*catalogue.effects, *own), fitted.poses)
        )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The model's causes."""
        return self.fitted.causes

    def screened(self, rng: np.random.Generator, known: Family | None = None) -> Screened:
        """Test what the model does not have yet; known is what the number of tests costs, if that is known."""
        others = tuple(c for c in self.regressors.candidates if not _acts(c.cause, self.causes))
        screening = Screening(replace(self.regressors, candidates=others))
        shown = {score.cause.place for score in screening.scores}
        every = {candidate.cause.place: candidate.cause for candidate in others}
        hidden = tuple(cause for place, cause in every.items() if place not in shown)
        return Screened(tuple(screening.scores), known or screening.family(rng), hidden)

    def apart(self, gone: Sequence[Cause]) -> Screening:
        """Test all candidates in the place of some causes, the others staying in the model; linear, without a refit."""
        whole, estimate = self.regressors, self.fitted.fit.estimate
        free = np.flatnonzero(~self.fitted.fit.at_bound)
        columns = np.flatnonzero(np.isin(free, np.concatenate([self.fitted.model.columns(cause) for cause in gone])))
        value = estimate[free[columns]]
        apart = whole.without(columns, whole.jacobian[:, columns] @ value, value * np.sqrt(whole.precision[columns]))
        stay = [cause for cause in self.causes if cause not in gone]
        others = tuple(c for c in apart.candidates if not _acts(c.cause, stay))
        return Screening(replace(apart, candidates=others))

    def findings(self, family: Family) -> list[Finding]:
        """Score all candidates in each cause's place."""
        return [Finding(cause, tuple(self.apart([cause]).scores), family) for cause in self.causes]


def _acts(cause: Cause, among: Sequence[Cause]) -> bool:
    """Whether a cause is among these, in this form or another."""
    return any(cause.place == other.place and cause.effect.same_as(other.effect) for other in among)
