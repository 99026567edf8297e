"""Stepwise search: a model extended by the causes that explain what it leaves, forward with a gate, then backward."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Generic

import numpy as np

from calflow.diagnosis.findings.verdict import WITHIN
from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import Family, by_place
from calflow.diagnosis.search.exchange import COLUMNS, SPLIT, Exchange, doubted
from calflow.diagnosis.search.linearisation import Detection, Screened
from calflow.diagnosis.search.trial import CauseAcceptance, Trial, forget_all_but, is_worth_trying, merged, swapped

CLEAR = 1e-3  # share of the acceptance below which the cost of the tests need not be worked out anew
ALONE = Family({}, 1.0)  # the cost of a single test: what does not pass at that passes at none
STEP = 0.2  # share of what is left of the search that a step counts as: how many there will be, nobody knows
MOST_TRIALS = 60  # models that are fitted in all: a search that needs more goes round in circles
ENTANGLED = 3  # causes, the last found, that are exchanged by two


@dataclass(frozen=True)
class Proposal(Generic[H]):
    """What to try next, and why in words; added is the last cause's score, where it is new."""

    causes: list[H]
    words: str
    added: Score[H] | None = None


@dataclass(frozen=True)
class Stepwise(Generic[H]):
    """What every step of the search needs; first is the screening of the model that it starts from.

    say is told each step in words, advance the share of the search that is done, which never falls.
    """

    acceptance: CauseAcceptance
    first: Screened[H]
    rng: np.random.Generator
    say: Callable[[str], None]
    advance: Callable[[float], None]

    def best(self, start: Trial[H]) -> tuple[Trial[H], list[Trial[H]]]:
        """Return the best model and all that were tried: steps and exchanges, until nothing changes."""
        tried = [start]
        best = self.settled(tried)
        while better := self.improved(best, tried):
            best = better
        if len(tried) >= MOST_TRIALS:
            self.say(f"the search ends after {MOST_TRIALS} models: there may be a better one")
        return best, tried

    def settled(self, tried: list[Trial[H]]) -> Trial[H]:
        """Add causes while one passes, drop or swap those that prove mistaken; return the best model whose causes all stand.

        tried grows by the models on the way.
        """
        begin = len(tried) - 1
        while step := self._next(tried):
            self.say(step.words)
            tried.append(tried[-1].with_causes(step.causes, step.added))
            tried[-2].forget()
            self.advance(1 - (1 - STEP) ** len(tried))
        best_first = sorted([tried[0], *tried[begin:]], key=lambda trial: trial.bic)
        best = next(trial for trial in best_first if self.stands(trial))
        forget_all_but(best, tried)
        return best

    def _next(self, tried: Sequence[Trial[H]]) -> Proposal[H] | None:
        """Return the next step from the last trial; none where there is no more, or where there were enough."""
        if len(tried) >= MOST_TRIALS:
            return None
        return next((step for step in self._steps(tried[-1]) if is_worth_trying(step.causes, tried)), None)

    def improved(self, best: Trial[H], tried: list[Trial[H]]) -> Trial[H] | None:
        """Return a better model that a merger, an exchange, or a rival in the place of a large cause leads to, if there is one."""
        others = (_replaced(best, causes) for causes in doubted(best))
        at_once = chain((_replaced(best, causes) for causes in merged(best)), self.exchanges(best))
        return self._led_to(best, tried, at_once, lambda _: False) or self._led_to(
            best, tried, others, lambda trial: trial.bic < best.bic + WITHIN and not self.stands(trial)
        )

    def _led_to(
        self, best: Trial[H], tried: list[Trial[H]], steps: Iterable[Proposal[H]], promising: Callable[[Trial[H]], bool]
    ) -> Trial[H] | None:
        """Return the first better model that one of the steps leads to; what is promising need not be better at once."""
        for step in steps:
            if len(tried) >= MOST_TRIALS:
                return None
            if not is_worth_trying(step.causes, tried):
                continue
            tried.append(best.with_causes(step.causes, step.added))
            if _cost(tried[-1]) < _cost(best) or promising(tried[-1]):
                self.say(step.words)
                if _cost(other := self.settled(tried)) < _cost(best):
                    return other
                self.say("that is no better")
            forget_all_but(best, tried)
        return None

    def stands(self, trial: Trial[H]) -> bool:
        """Whether each of a trial's causes would pass again."""
        return all(map(self.acceptance.keeps, trial.findings))

    def exchanges(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        """Yield the causes with one or two in the place of two, or two in that of one, where that explains the data better."""
        small = [cause for cause in trial.causes if cause.n_parameters <= COLUMNS][-ENTANGLED:]
        for gone in (*combinations(small, 2), *combinations(small, 1)):
            exchange = Exchange.of(trial.linearisation.apart(gone), trial.family, gone)
            stay = [cause for cause in trial.causes if cause not in gone]
            if (single := exchange.alone()) and self.acceptance.accepts(single, trial.family):
                yield _replaced(trial, [*stay, single.cause])
            pairs = exchange.better() if len(stay) + 2 <= self.acceptance.most else ()
            if pair := next((pair for pair in pairs if pair.p < self.acceptance.false_alarm), None):
                yield _replaced(trial, [*stay, pair.first.cause, pair.second.cause])

    def _steps(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        yield from (_replaced(trial, causes) for causes in trial.refined())
        if len(trial.causes) < self.acceptance.most:
            yield from _added(trial, self.first, self.acceptance, self.rng)
        yield _replaced(trial, second_thoughts(trial.findings, self.acceptance))


def _added(
    trial: Trial[H], first: Screened[H], acceptance: CauseAcceptance, rng: np.random.Generator
) -> Iterator[Proposal[H]]:
    """The causes with the best one that is accepted."""
    now = trial.linearisation.screened(rng, first.family) if trial.causes else first
    passed = [score for score in now.scores if acceptance.accepts(score, now.family)]
    doubtful = not (passed and now.family.p(passed[0]) < CLEAR * acceptance.false_alarm)
    if trial.causes and doubtful and any(acceptance.accepts(score, ALONE) for score in now.scores):
        now = trial.linearisation.screened(rng)  # what the tests cost depends on what is left, where it matters
        passed = [score for score in now.scores if acceptance.accepts(score, now.family)]
    if not passed:
        return
    best = trial.finest(min(passed, key=lambda score: score.delta_bic + score.unusual))  # usual sizes first
    message = f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {now.family.p(best):.2g}"
    yield Proposal([*trial.causes, best.cause], message, best)


def _replaced(trial: Trial[H], causes: list[H]) -> Proposal[H]:
    return Proposal(causes, _difference(trial.causes, causes))


def _difference(before: Sequence[H], after: Sequence[H]) -> str:
    gone, come = ([c for c in these if c not in those] for these, those in ((before, after), (after, before)))
    if not gone:
        return f"{' and '.join(map(words, come))} besides"
    give = "give" if len(gone) > 1 else "gives"
    return f"{' and '.join(map(words, gone))} {give} way to {' and '.join(map(words, come)) or 'nothing'}"


def words(cause: H) -> str:
    """Name a cause for a log line."""
    return " ".join(filter(None, (cause.id, cause.part, f"({cause.detail})" if cause.detail else "")))


def second_thoughts(findings: Sequence[Detection[H]], acceptance: CauseAcceptance) -> list[H]:
    """Return the causes that stay, a more probable rival in the place of one; one change at a time."""
    causes = [finding.cause for finding in findings]
    weakest = sorted(findings, key=lambda finding: -_own_bic(finding))
    for finding in weakest:
        if not acceptance.keeps(finding):
            return [cause for cause in causes if cause != finding.cause]
    for finding in weakest:
        places = by_place(finding.scores)
        usual = {place: evidence + score.unusual for place, (evidence, score) in places.items()}
        best = places[min(usual, key=lambda place: usual[place])][1]
        if usual[best.cause.place] < usual[finding.cause.place] and acceptance.accepts(best, finding.family):
            return swapped(causes, finding.cause, best.cause)
    return causes


def _cost(trial: Trial[H]) -> float:
    """BIC, where two causes must explain the data clearly better than one does."""
    return trial.bic + SPLIT * len(trial.causes)


def _own_bic(finding: Detection[H]) -> float:
    return next((score.delta_bic for score in finding.scores if score.cause == finding.cause), 0.0)
