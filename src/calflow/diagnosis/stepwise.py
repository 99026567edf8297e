"""Stepwise model search: causes are added to a model while one is accepted, then dropped, replaced, merged or exchanged.

Orders found one after another on a joint are often one curve, successive steps one drift: all of a family at a joint are merged
into one, to which no replacement of a single cause leads. Similar causes mask each other, a third that explains most of both
being found first: two at once are exchanged for others. Steps that the linearisation excludes are not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Any, Generic, TypeVar

import numpy as np

from calflow.diagnosis.regressors import H, Hypothesis
from calflow.diagnosis.screening import Family, Score, by_place
from calflow.diagnosis.trial import Detection, Trial

WITHIN = 10.0  # cost: closer rivals are not distinguished (Kass and Raftery 1995: "very strong" beyond)
REACH = 7.0  # log odds against a model in reach, at most: a probability of 0.1 %
PATIENCE = 3  # models with causes at the same places that may fail to improve on an earlier one
BETTER = 1.0  # least decrease of cost that counts as an improvement
SHARES = {"causes": 0.7, "unexplained": 0.2, "noise": 0.1}  # of the false-alarm rate
FEW_COLUMNS = 4  # parameters of a candidate at most: error maps have rivals of their own
BEST_PLACES = 8  # places of which one cause of a pair is, the best
SPLIT = 10.0  # least decrease of cost for two causes in place of one (Kass and Raftery 1995: "very strong")
DOUBT = 0.05  # relative error of a linear comparison, as a share of the evidence of what is removed
CLEAR = 0.1  # share of the false-alarm rate below which the correction need not be recomputed: it grows twofold at most
STEP_SHARE = 0.2  # progress of a step as a share of the remaining search, whose length is unknown
MOST_TRIALS = 60  # models that are fitted in all: a search that needs more is cyclic
ENTANGLED = 3  # causes, the last found, that are exchanged in pairs

T = TypeVar("T", bound=Trial)


def forget_all_but(best: Trial, tried: Sequence[Trial]) -> None:
    """Release the linearised models of all trials but one, their largest objects, which are recomputed on demand."""
    for trial in tried:
        if trial is not best:
            vars(trial).pop("linearisation", None)


def is_worth_trying(causes: Sequence[Any], tried: Sequence[Trial]) -> bool:
    """Whether no trial had these causes, and trials with causes at the same places still improve.

    Variants between neighbours (an order of 7.31, then 7.32) make every set of causes a new one, so that a cause could be added
    and dropped alternately for ever.
    """
    where = sorted(cause.place for cause in causes)
    costs = [trial.cost for trial in tried if sorted(cause.place for cause in trial.causes) == where]
    stuck = len(costs) > PATIENCE and min(costs[-PATIENCE:]) > min(costs[:-PATIENCE]) - BETTER
    return not stuck and all(set(causes) != set(trial.causes) for trial in tried)


@dataclass(frozen=True)
class CauseAcceptance:
    """Acceptance of causes: the family-wise false-alarm rate, and the largest number of causes."""

    false_alarm: float
    most: int

    def accepts(self, score: Score, family: Family) -> bool:
        """Whether a candidate has favourable evidence, explains a material share of chi², and is significant."""
        return score.cost < 0 and score.share > family.material and family.p(score) < self.false_alarm

    def passing(self, scores: Sequence[Score[H]], family: Family) -> list[Score[H]]:
        """Return the scores of accepted candidates, in their order."""
        return [score for score in scores if self.accepts(score, family)]

    def keeps(self, finding: Detection) -> bool:
        """Whether a cause of the model would be accepted again."""
        return any(score.cause == finding.cause and self.accepts(score, finding.family) for score in finding.scores)

    def better(self, finding: Detection[H]) -> Score[H] | None:
        """Return the best candidate in a cause's place, if it is a more probable rival, or another form that explains more."""
        cost, best = min(finding.places.values(), key=lambda scored: scored[0])
        better = cost < finding.cost or best.cost < finding.own.cost - BETTER
        return best if better and self.accepts(best, finding.family) else None


Kin = tuple[str, int]  # a family and the joint (0 for none) where its members act


def kindred(causes: Sequence[H]) -> dict[Kin, list[H]]:
    """Return the causes of each family at each joint, if there are several."""
    groups: dict[Kin, list[H]] = {}
    for cause in causes:
        if cause.family:
            groups.setdefault((cause.family, cause.joint), []).append(cause)
    return {kin: members for kin, members in groups.items() if len(members) > 1}


def merged(trial: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with all members of a family at a joint replaced by one, the best place first."""
    for (family, joint), members in kindred(trial.causes).items():
        stay = [cause for cause in trial.causes if cause not in members]
        scores = trial.linearisation.apart(members).scores
        alike = [score for score in scores if (score.cause.family, score.cause.joint) == (family, joint)]
        for _, best in sorted(by_place(alike).values(), key=lambda scored: scored[0]):
            yield [*stay, best.cause]


@dataclass(frozen=True)
class Proposal(Generic[H]):
    """A proposed step: the causes, and the reason in words; added is the score of the last cause, if it is new.

    cost is by how much minus twice the log evidence changes in the linearised model, of steps that compete.
    """

    causes: list[H]
    words: str
    added: Score[H] | None = None
    cost: float = 0.0


@dataclass(frozen=True)
class Stepwise:
    """The stepwise search.

    say receives each step in words, advance the share of the search that is done, which never falls.
    """

    acceptance: CauseAcceptance
    rng: np.random.Generator
    say: Callable[[str], None]
    advance: Callable[[float], None]

    def best(self, *start: T) -> T:
        """Return the best model, starting from the last of start, by steps and exchanges until nothing improves."""
        tried = list(start)
        best = self.settled(tried)
        while better := self.improved(best, tried):
            best = better
        if len(tried) >= MOST_TRIALS:
            self.say(f"the search ends after {MOST_TRIALS} models: there may be a better one")
        return best

    def settled(self, tried: list[T]) -> T:
        """Add, drop and replace causes while that improves the last model of tried; return the best whose causes are all accepted.

        A step that proves worse than expected is undone, and not tried again: from a model at most one of each kind fails.
        """
        begin, now = len(tried) - 1, tried[-1]
        steps = _untried(self._steps(now), tried)
        while step := next(steps, None):
            self.say(step.words)
            tried.append(now.with_causes(step.causes, step.added))
            if tried[-1].cost < now.cost + BETTER or len(step.causes) < len(now.causes):
                now = tried[-1]
                steps = _untried(self._steps(now), tried)
                forget_all_but(now, tried)
            else:
                self.say("that is no better")
            self.advance(1 - (1 - STEP_SHARE) ** len(tried))
        best_first = sorted([tried[0], *tried[begin:]], key=lambda trial: trial.cost)
        best = next(trial for trial in best_first if self.stands(trial))
        forget_all_but(best, tried)
        return best

    def improved(self, best: T, tried: list[T]) -> T | None:
        """Return a better model reached by a merger or an exchange, if there is one."""
        for step in _untried(chain(_within_reach(best, merged(best)), self.exchanges(best)), tried):
            tried.append(best.with_causes(step.causes, step.added))
            if _cost_apart(tried[-1]) < _cost_apart(best):
                self.say(step.words)
                if _cost_apart(other := self.settled(tried)) < _cost_apart(best):
                    return other
                self.say("that is no better")
            forget_all_but(best, tried)
        return None

    def stands(self, trial: Trial[H]) -> bool:
        """Whether each of a trial's causes would be accepted again."""
        return all(map(self.acceptance.keeps, trial.own_findings))

    def exchanges(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        """Yield the causes with two replaced by one or two, or one by two, if better: one of the best and one beside it."""
        small = [cause for cause in trial.causes if _is_small(cause)][-ENTANGLED:]
        for gone in (*combinations(small, 2), *combinations(small, 1)):
            stay, linear = [cause for cause in trial.causes if cause not in gone], trial.linearisation
            singles = _small(trial, stay)
            now, best = -linear.rise(gone), next(iter(singles), None)
            if best and len(gone) == 2 and best.cost < now and self.acceptance.accepts(best, trial.first.family):
                yield _replaced(trial, [*stay, best.cause])
            if len(stay) + 2 > self.acceptance.most:
                continue
            limit = now if len(gone) == 2 else now - SPLIT
            firsts = sorted(by_place(singles).values(), key=lambda scored: scored[0])[:BEST_PLACES]
            pairs = sorted(self._pairs(trial, stay, [first for _, first in firsts]), key=lambda pair: pair[0])
            better = (pair for cost, pair in pairs if cost < limit and set(pair) != set(trial.causes))
            if pair := next((pair for pair in better if self._significant(trial, pair)), None):
                yield _replaced(trial, pair)

    def _pairs(self, trial: Trial[H], stay: list[H], firsts: Sequence[Score[H]]) -> Iterator[tuple[float, list[H]]]:
        """Yield the causes with each of some candidates added, and the best beside it, and what both cost, linear."""
        for first in firsts:
            second = next(iter(_small(trial, [*stay, first.cause])), None)
            if second and second.cause.place != first.cause.place:
                yield first.cost + second.cost, [*stay, first.cause, second.cause]

    def _significant(self, trial: Trial[H], causes: list[H]) -> bool:
        """Whether each of the last two causes, which are new, is significant beside the others."""
        for k in (-2, -1):
            beside = [cause for cause in causes if cause != causes[k]]
            own = (score for score in trial.linearisation.forms(beside, causes[k].place) if score.cause == causes[k])
            if not any(trial.first.family.p(score) < self.acceptance.false_alarm for score in own):
                return False
        return True

    def _steps(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        yield _replaced(trial, trial.refined())
        yield from sorted(chain(self._reformed(trial), self._added(trial)), key=lambda step: step.cost)
        yield _replaced(trial, second_thoughts(trial, self.acceptance))

    def _reformed(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        """Yield the causes with the last one in another of its forms, if that explains more than its own.

        What is left of a cause in a wrong form may look like another cause, whose own form would then hide the first's.
        """
        if not trial.causes:
            return
        *others, last = trial.causes
        finding = trial.linearisation.finding(last, trial.first.family, [last.place])
        if self.acceptance.keeps(finding) and (best := self.acceptance.better(finding)):
            yield replace(_replaced(trial, [*others, best.cause]), cost=best.cost - finding.own.cost)

    def _added(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        """Yield the causes with the best accepted candidate added, if there is one and room for it."""
        if len(trial.causes) >= self.acceptance.most:
            return
        now = trial.linearisation.screened(self.rng, trial.first.family) if trial.causes else trial.first
        passed = self.acceptance.passing(now.scores, now.family)
        doubtful = not (passed and now.family.p(passed[0]) < CLEAR * self.acceptance.false_alarm)
        # Without correction for the number of tests: a candidate that fails here fails with it, too.
        single = replace(now.family, scans={}, places=1.0)
        if trial.causes and doubtful and self.acceptance.passing(now.scores, single):
            now = trial.linearisation.screened(self.rng)  # with the correction for this model's residual
            passed = self.acceptance.passing(now.scores, now.family)
        if passed:
            best = trial.finest(passed[0])
            message = f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {now.family.p(best):.2g}"
            yield Proposal([*trial.causes, best.cause], message, best, best.cost)


def _untried(steps: Iterable[Proposal[H]], tried: Sequence[Trial[H]]) -> Iterator[Proposal[H]]:
    """Yield the steps that are worth trying, until MOST_TRIALS is reached."""
    steps = iter(steps)
    while len(tried) < MOST_TRIALS and (step := next(steps, None)):
        if is_worth_trying(step.causes, tried):
            yield step


def _is_small(cause: Hypothesis) -> bool:
    return cause.n_parameters <= FEW_COLUMNS


def _small(trial: Trial[H], causes: Sequence[H]) -> list[Score[H]]:
    """Return the scores of causes of few parameters beside the given ones, best first."""
    places = {each.cause.place for each in trial.linearisation.regressors.candidates if _is_small(each.cause)}
    scores = trial.linearisation.tested_with(causes, places).scores if places else []
    return [score for score in scores if _is_small(score.cause)]


def _replaced(trial: Trial[H], causes: list[H]) -> Proposal[H]:
    return Proposal(causes, _difference(trial.causes, causes))


def _within_reach(trial: Trial[H], others: Iterable[list[H]]) -> Iterator[Proposal[H]]:
    """Yield the sets of causes that may be better within the error of the linearised model, a share of what is removed."""
    for causes in others:
        doubt = DOUBT * trial.linearisation.rise([cause for cause in trial.causes if cause not in causes])
        if trial.linearisation.expected(causes) < WITHIN * max(1, len(trial.causes) - len(causes)) + doubt:
            yield _replaced(trial, causes)


def _difference(before: Sequence[H], after: Sequence[H]) -> str:
    gone, come = ([c for c in these if c not in those] for these, those in ((before, after), (after, before)))
    if not gone:
        return f"{' and '.join(map(words, come))} besides"
    give = "give" if len(gone) > 1 else "gives"
    return f"{' and '.join(map(words, gone))} {give} way to {' and '.join(map(words, come)) or 'nothing'}"


def words(cause: H) -> str:
    """Return the name of a cause for a log line."""
    return " ".join(filter(None, (cause.id, cause.part, f"({cause.detail})" if cause.detail else "")))


def second_thoughts(trial: Trial[H], acceptance: CauseAcceptance) -> list[H]:
    """Return the causes with one dropped that is no longer accepted, or replaced by a more probable rival or another form of its
    own that explains the data better; one change at most.
    """
    for finding in _weakest_first(trial.own_findings):
        if not acceptance.keeps(finding):
            return [cause for cause in trial.causes if cause != finding.cause]
    for finding in _weakest_first(trial.findings):
        if best := acceptance.better(finding):
            return [best.cause if cause == finding.cause else cause for cause in trial.causes]
    return list(trial.causes)


def _cost_apart(trial: Trial[H]) -> float:
    """Return the cost with a penalty of SPLIT per cause, so that two must be clearly better than one."""
    return trial.cost + SPLIT * len(trial.causes)


def _weakest_first(findings: Sequence[Detection[H]]) -> list[Detection[H]]:
    own = {f.cause: next((score.cost for score in f.scores if score.cause == f.cause), 0.0) for f in findings}
    return sorted(findings, key=lambda finding: -own[finding.cause])
