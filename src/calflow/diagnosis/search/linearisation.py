"""A look at a model: every candidate beside it, or in the place of a cause that it has, from one linearisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.regressors import Candidate, Regressors
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import Family, Screening
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects.cause import Cause


@dataclass(frozen=True)
class Detection(Generic[H]):
    """A cause in the extended model, with all candidates' scores where it is taken out and the others stay.

    unnamed is the BIC of what nobody can name in its place, above its own; carries_over whether it holds at blocks of training
    poses that were left out, None where that was not tried.
    """

    cause: H
    scores: tuple[Score[H], ...]
    family: Family
    unnamed: float = np.inf
    carries_over: bool | None = None

    @property
    def own(self) -> Score[H]:
        """The cause's own score."""
        return next(score for score in self.scores if score.cause == self.cause)

    @property
    def p(self) -> float:
        """The chance that anything in the family looks like this where nothing is hidden."""
        return self.family.p(self.own)


@dataclass(frozen=True)
class Screened(Generic[H]):
    """All candidates' scores against one model, best first, what their number costs, and which places cannot be seen."""

    scores: tuple[Score[H], ...]
    family: Family
    hidden: tuple[H, ...]

    @property
    def places(self) -> set[tuple[str, str]]:
        """The places that were tested."""
        return {score.cause.place for score in self.scores}


@dataclass(frozen=True)
class Linearisation(Generic[H]):
    """One model with causes, and all candidates' regressors there, from one Jacobian.

    value (n_free,) are the free parameters' estimates; columns says of each cause which of them are its own.
    """

    causes: tuple[H, ...]
    regressors: Regressors[H]
    value: np.ndarray
    columns: tuple[np.ndarray, ...]

    @staticmethod
    def at(fitted: Fitted, catalogue: Catalogue) -> Linearisation[Cause]:
        """Linearise a fitted model; its own causes are among the candidates, for when they are taken out."""
        added = (cause for cause in fitted.causes if cause.effect not in catalogue.effects)
        regressors = fitted.regressors((*catalogue.effects, *added))
        free = np.flatnonzero(~fitted.fit.at_bound)
        columns = tuple(np.flatnonzero(np.isin(free, fitted.model.columns(cause))) for cause in fitted.causes)
        return Linearisation(fitted.causes, regressors, fitted.fit.estimate[free], columns)

    def screened(self, rng: np.random.Generator, family: Family | None = None) -> Screened[H]:
        """Test what the model does not have yet; known is what the number of tests costs, if that is known."""
        screening = self.beside
        shown = {score.cause.place for score in screening.scores}
        every = {candidate.cause.place: candidate.cause for candidate in screening.regressors.candidates}
        hidden = tuple(cause for place, cause in every.items() if place not in shown)
        return Screened(tuple(screening.scores), family or screening.family(rng), hidden)

    @property
    def beside(self) -> Screening[H]:
        """The test of all candidates that the model does not have, beside its own causes."""
        others = _besides(self.regressors.candidates, self.causes)
        return Screening(replace(self.regressors, candidates=others))

    def apart(self, gone: Sequence[H]) -> Screening[H]:
        """Test all candidates in the place of some causes, the others staying in the model; linear, without a refit."""
        whole = self.regressors
        columns = np.sort(np.concatenate([self.columns[self.causes.index(cause)] for cause in gone]))
        apart = whole.without(columns, self.value[columns])
        stay = [cause for cause in self.causes if cause not in gone]
        return Screening(replace(apart, candidates=_besides(apart.candidates, stay)))

    def findings(self, family: Family) -> list[Detection[H]]:
        """Score all candidates in each cause's place."""
        return [Detection(cause, tuple(self.apart([cause]).scores), family) for cause in self.causes]


def _besides(candidates: Sequence[Candidate[H]], causes: Sequence[H]) -> tuple[Candidate[H], ...]:
    """Return the candidates that are not among these causes, in this form or another."""
    acting: dict[tuple[str, str], list[H]] = {}
    for cause in causes:
        acting.setdefault(cause.place, []).append(cause)
    return tuple(
        c for c in candidates if not any(c.cause.same_form(present) for present in acting.get(c.cause.place, ()))
    )
