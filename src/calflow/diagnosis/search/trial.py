"""A trial: a model that the search tried, what it costs in BIC, and how to go on to another.

The gate: what a cause must show to be added to the model, and to stay there.

Merging: several causes of one family at one place give way to a single one that holds them all.

Orders found one after another on a joint are often one curve, steps one after another one drift. No swap of one cause leads
there, since each of the others explains its part already.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Self

import numpy as np

from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import MATERIAL, Family, by_place, prior_cost
from calflow.diagnosis.search.linearisation import Detection, Linearisation

PATIENCE = 3  # models with causes at the same places that may be no better than one before them
BETTER = 1.0  # of BIC: by how much one must be better to count as that


@dataclass(frozen=True)
class Trial(ABC, Generic[H]):
    """A model that was tried; family is the first screening's cost of the tests."""

    family: Family

    @property
    @abstractmethod
    def causes(self) -> tuple[H, ...]:
        """Its causes."""

    @property
    @abstractmethod
    def n_residuals(self) -> int:
        """How many residuals it was fitted to."""

    @property
    @abstractmethod
    def bic(self) -> float:
        """What it costs, to be compared with other trials: see `bic`."""

    @cached_property
    @abstractmethod
    def linearisation(self) -> Linearisation[H]:
        """The linearised model."""

    def forget(self) -> None:
        """Let go of the linearised model, the largest thing that a trial holds; it is worked out anew if it is asked for."""
        vars(self).pop("linearisation", None)

    @abstractmethod
    def with_causes(self, causes: Sequence[H], added: Score[H] | None = None) -> Self:
        """Fit the model with these causes instead; added is the score of the last one, where it is new and so expected."""

    def finest(self, score: Score[H]) -> Score[H]:
        """Return the best form of a cause that is not in the model yet: a scan may have steps between its variants."""
        return score

    def in_place(self, gone: Sequence[H], cause: H) -> H:
        """Return the form of a cause that is best in the place of others: a rival is judged by its best one."""
        return cause

    def refined(self) -> Iterator[list[H]]:
        """Yield the causes with one in a form that is clearly better, now that the others are in the model."""
        yield from ()

    @cached_property
    def findings(self) -> tuple[Detection[H], ...]:
        """Its causes, each weighed against all candidates in its place."""
        return tuple(self.linearisation.findings(self.family)) if self.causes else ()


def bic(misfit: float, n: int, parameters: float, variants: Sequence[int]) -> float:
    """Return BIC of a model whose misfit may be compared with others': parameters, and the variants that were tried of causes."""
    return float(n * np.log(misfit) + parameters * np.log(n) + 2 * sum(np.log(number) for number in variants))


def relief(offset: np.ndarray, prior_sd: np.ndarray) -> float:
    """Return by how much a cause's parameters (n,) pull at their priors beyond what that costs."""
    pulled = float(((offset / prior_sd) ** 2).sum())
    return pulled - float(prior_cost(np.array(pulled), len(offset)))


def forget_all_but(best: Trial, tried: Sequence[Trial]) -> None:
    """Let go of the linearised models of all but one."""
    for trial in tried:
        if trial is not best:
            trial.forget()


def same(causes: Sequence[H], others: Sequence[H]) -> bool:
    """Whether these are the same causes, in any order."""
    return len(causes) == len(others) and all(cause in others for cause in causes)


def is_new(causes: Sequence[Any], tried: Sequence[Trial]) -> bool:
    """Whether no trial had these causes."""
    return not any(same(causes, trial.causes) for trial in tried)


def is_worth_trying(causes: Sequence[Any], tried: Sequence[Trial]) -> bool:
    """Whether no trial had these causes, and trials with causes at the same places have not stopped getting better.

    Variants between neighbours (an order of 7.31, then 7.32) make every set of causes a new one, so that a cause could be added
    and dropped in turns for ever.
    """
    where = sorted(cause.place for cause in causes)
    costs = [trial.bic for trial in tried if sorted(cause.place for cause in trial.causes) == where]
    stuck = len(costs) > PATIENCE and min(costs[-PATIENCE:]) > min(costs[:-PATIENCE]) - BETTER
    return not stuck and is_new(causes, tried)


def swapped(causes: Sequence[H], gone: H, come: H) -> list[H]:
    """Return the causes with one in the place of another."""
    return [come if cause == gone else cause for cause in causes]


FALSE_ALARM = 0.01  # the chance that anything is found where nothing is hidden, unless a study says otherwise
SHARES = {"causes": 0.7, "remainder": 0.2, "noise": 0.1}  # of the false alarms that are allowed


@dataclass(frozen=True)
class CauseAcceptance:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int

    def accepts(self, score: Score, family: Family) -> bool:
        """Whether a candidate pays, matters, and is no accident."""
        return score.delta_bic < 0 and score.share > MATERIAL and family.p(score) < self.false_alarm

    def keeps(self, finding: Detection) -> bool:
        """Whether a cause that is in the model would pass again."""
        scores = [score for score in finding.scores if score.cause == finding.cause]
        return bool(scores) and self.accepts(scores[0], finding.family)


Kin = tuple[str, int]  # a family and the joint (0 for none) where its members act


def kindred(causes: Sequence[H]) -> dict[Kin, list[H]]:
    """Return the causes of each family at each joint, where there are several."""
    groups: dict[Kin, list[H]] = {}
    for cause in causes:
        if cause.family:
            groups.setdefault((cause.family, cause.joint), []).append(cause)
    return {kin: members for kin, members in groups.items() if len(members) > 1}


def merged(trial: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with one of a family in the place of all its members at a joint, the best of each place first."""
    for (family, joint), members in kindred(trial.causes).items():
        stay = [cause for cause in trial.causes if cause not in members]
        scores = trial.linearisation.apart(members).scores
        alike = [score for score in scores if (score.cause.family, score.cause.joint) == (family, joint)]
        for _, best in sorted(by_place(alike).values(), key=lambda scored: scored[0]):
            yield [*stay, best.cause]
