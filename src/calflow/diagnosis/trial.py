"""A trial: a fitted model of the stepwise search. Its linearisation scores candidates beside its causes, or in the place of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Self

import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Background, H, Place, Regressors
from calflow.diagnosis.screening import Family, Score, Screening, by_place
from calflow.effects import Effect
from calflow.effects.cause import Cause


@dataclass(frozen=True)
class Detection(Generic[H]):
    """A cause in the extended model, with the scores of all candidates in its place, beside the other causes.

    unnamed: cost of an unnamed error in its place, above its own; carries_over: whether it gains at left-out blocks of training
    poses, None where that was not tested.
    """

    cause: H
    scores: tuple[Score[H], ...]
    family: Family
    unnamed: float = np.inf
    carries_over: bool | None = None

    @property
    def is_shown(self) -> bool:
        """Whether the data show the cause at all beside the others: it has no score where they hardly tell it from them."""
        return any(score.cause == self.cause for score in self.scores)

    @property
    def own(self) -> Score[H]:
        return next(score for score in self.scores if score.cause == self.cause)

    @cached_property
    def places(self) -> dict[Place, tuple[float, Score[H]]]:
        return by_place(self.scores)

    @property
    def cost(self) -> float:
        return self.places[self.cause.place][0]

    @property
    def p(self) -> float:
        """Family-wise p-value of the cause."""
        return self.family.p(self.own)


@dataclass(frozen=True)
class Screened(Generic[H]):
    """Scores of all testable candidates against one model, best first, and the correction for their number.

    degrees_of_freedom are the model's residual ones.
    """

    scores: tuple[Score[H], ...]
    family: Family
    degrees_of_freedom: float


@dataclass(frozen=True)
class Linearisation(Generic[H]):
    """A model with causes, linearised, with the regressors of all candidates from one Jacobian.

    value (n_free,) are the free parameters' estimates; columns are, for each cause, the indices of its own.
    """

    causes: tuple[H, ...]
    regressors: Regressors[H]
    value: np.ndarray
    columns: tuple[np.ndarray, ...]

    @staticmethod
    def at(fitted: Fitted, effects: Sequence[Effect], still: Cause | None = None) -> Linearisation[Cause]:
        """Return a fitted model, one of its causes at zero if still, linearised with effects and its causes as candidates."""
        added = (cause for cause in fitted.causes if cause.effect not in effects)
        at = fitted.still(still) if still else fitted
        regressors = fitted.regressors((*effects, *added), at.fit)
        columns = tuple(at.own(cause)[0] for cause in fitted.causes)
        return Linearisation(fitted.causes, regressors, at.fit.estimate[~at.fit.at_bound], columns)

    def beside_another(self, background: Background | None, weight: np.ndarray) -> Linearisation[H]:
        """Return the same model beside another background, or none, with whitening factors (n,) of the residuals."""
        now = self.regressors
        alone = now.without(now.random, np.zeros(len(now.random)))
        return replace(self, regressors=alone.beside(background, weight))

    def screened(self, rng: np.random.Generator, family: Family | None = None) -> Screened[H]:
        """Return the tests of all causes that the model lacks; family is the correction for their number, if it is known."""
        tests = self.beside
        return Screened(tuple(tests.scores), family or tests.family(rng), tests.degrees_of_freedom)

    @cached_property
    def whole(self) -> LinearModel[H]:
        return LinearModel(self.regressors)

    @cached_property
    def beside(self) -> Screening[H]:
        """Tests of all candidates that the model lacks, beside its causes."""
        return self.tested_with(self.causes)

    def tested_with(self, causes: Sequence[H], where: Collection[Place] = ()) -> Screening[H]:
        """Return the tests of all other candidates, or those of some places, beside the given causes, linear, without a refit."""
        every, places = self.regressors.candidates, {cause.place for cause in causes}
        there = np.array([not where or c.cause.place in where for c in every])
        for k in (k for k, c in enumerate(every) if c.cause.place in places):
            there[k] &= not any(map(every[k].cause.same_form, causes))
        gone = [self.columns[k] for k, cause in enumerate(self.causes) if cause not in causes]
        new = [cause for cause in causes if cause not in self.causes]
        come = [c.columns for c in every if c.cause.place in places and c.cause in new]
        out, into = (np.sort(np.concatenate([np.zeros(0, dtype=int), *parts])) for parts in (gone, come))
        return Screening(self.whole, np.flatnonzero(there), out, self.value[out], into)

    def apart(self, gone: Sequence[H], where: Collection[Place] = ()) -> Screening[H]:
        """Return the tests of all candidates, or those of some places, with some causes removed, beside the others."""
        return self.tested_with([cause for cause in self.causes if cause not in gone], where)

    def rise(self, gone: Sequence[H]) -> float:
        """Return the increase of the cost without some causes, removed one after another."""
        return -sum(self._cost(gone[: k + 1], cause) for k, cause in enumerate(gone))

    def expected(self, causes: Sequence[H]) -> float:
        """Return the linear increase of the cost with other causes, one of them new at most, scored as the best of its place."""
        gone = [cause for cause in self.causes if cause not in causes]
        return self.rise(gone) + sum(self._cost(gone, cause) for cause in causes if cause not in self.causes)

    def finding(self, cause: H, family: Family, where: Collection[Place] = ()) -> Detection[H]:
        """Return a cause with the scores of all candidates in its place, or those of some places: a small part of the time."""
        return Detection(cause, tuple(self.apart([cause], where).scores), family)

    def forms(self, causes: Sequence[H], place: Place) -> list[Score[H]]:
        """Return the scores of all forms of a place beside the given causes, best first."""
        return self.tested_with(causes, [place]).scores

    def _cost(self, gone: Sequence[H], cause: H) -> float:
        """Return the cost of a cause with others removed; zero where it is not testable."""
        scores = self.forms([other for other in self.causes if other not in gone], cause.place)
        own = [score.cost for score in scores if score.cause == cause]
        return min(own or (score.cost for score in scores), default=0.0)


@dataclass(frozen=True)
class Trial(ABC, Generic[H]):
    """A fitted model of the search; first is the screening of the model without causes."""

    first: Screened[H]

    @property
    @abstractmethod
    def causes(self) -> tuple[H, ...]:
        """Its causes."""

    @property
    @abstractmethod
    def cost(self) -> float:
        """Minus twice the log evidence, comparable between trials (see `refitted_cost`)."""

    @cached_property
    @abstractmethod
    def linearisation(self) -> Linearisation[H]:
        """The linearised model."""

    @abstractmethod
    def with_causes(self, causes: Sequence[H], added: Score[H] | None = None) -> Self:
        """Return the model fitted with these causes instead; added is the score of the last one, if it is new."""

    def finest(self, score: Score[H]) -> Score[H]:
        """Return the score of a candidate's best form beside the causes, once refined."""
        return score

    def refined(self) -> list[H]:
        """Return the causes in forms that are clearly better beside the other causes of the model."""
        return list(self.causes)

    @cached_property
    def findings(self) -> tuple[Detection[H], ...]:
        """Its causes, each with the scores of all candidates in its place."""
        return tuple(self.linearisation.finding(cause, self.first.family) for cause in self.causes)

    @property
    def own_findings(self) -> tuple[Detection[H], ...]:
        """Its causes, each with the scores of its own place at least, which tell whether it stays."""
        return self.findings
