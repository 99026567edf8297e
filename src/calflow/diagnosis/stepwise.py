"""Stepwise search: a model extended by the causes that explain what it leaves, forward with a gate, then backward.

A trial is a model that was tried. Linearised, it shows every candidate beside it, or in the place of a cause that it has.

Merging: several causes of one family at one place give way to a single one that holds them all. Orders found one after another
on a joint are often one curve, steps one after another one drift. No swap of one cause leads there, since each of the others
explains its part already.

Exchange: two causes at once in the place of others, where one at a time leads astray. Causes that resemble each other hide each
other: the one that explains most of both is found first, and no swap of a single cause leads back. All pairs are scored from
the same linearisation as single causes are (see `screening`).

Verification: rivals of a large cause are fitted in its place, where one linearisation is not exact enough to exclude them.

What the linearisation does exclude is not fitted: it is trusted but for a share of what is taken out, and for as much as it was
wrong about in the step before. A step that proves worse is taken back, so that no more than one of each kind fails at a model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations
from typing import Any, Generic, Self

import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Candidate, H, Regressors
from calflow.diagnosis.screening import INVISIBLE, Catalogue, Family, Score, Screening, by_place
from calflow.effects.base import Cause
from calflow.estimation.variance_components import (
    LOG_PRIOR,
    SIZES,
    directions,
    explained,
    log_likelihood,
    mixed,
    size_cost,
)


@dataclass(frozen=True)
class Detection(Generic[H]):
    """A cause in the extended model, with all candidates' scores where it is taken out and the others stay.

    unnamed is the cost of what nobody can name in its place, above its own; carries_over whether it holds at blocks of training
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
    """All candidates' scores against one model, best first, what their number costs, and which places cannot be seen.

    degrees_of_freedom are those of what the model leaves.
    """

    scores: tuple[Score[H], ...]
    family: Family
    hidden: tuple[H, ...]
    degrees_of_freedom: float

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
        columns = tuple(fitted.own(cause)[0] for cause in fitted.causes)
        return Linearisation(fitted.causes, regressors, fitted.fit.estimate[~fitted.fit.at_bound], columns)

    def screened(self, rng: np.random.Generator, family: Family | None = None) -> Screened[H]:
        """Test what the model does not have yet; known is what the number of tests costs, if that is known."""
        screening = self.beside
        shown = {score.cause.place for score in screening.scores}
        every = {candidate.cause.place: candidate.cause for candidate in screening.regressors.candidates}
        hidden = tuple(cause for place, cause in every.items() if place not in shown)
        return Screened(tuple(screening.scores), family or screening.family(rng), hidden, screening.degrees_of_freedom)

    @property
    def beside(self) -> Screening[H]:
        """The test of all candidates that the model does not have, beside its own causes."""
        return self.tested_with(self.causes)

    def tested_with(self, causes: Sequence[H]) -> Screening[H]:
        """Test all other candidates beside these causes, whichever the model has; linear, without a refit."""
        gone = [cause for cause in self.causes if cause not in causes]
        regressors = self.regressors
        if gone:
            columns = np.sort(np.concatenate([self.columns[self.causes.index(cause)] for cause in gone]))
            regressors = regressors.without(columns, self.value[columns])
        come = [c.columns for c in regressors.candidates if c.cause in causes and c.cause not in self.causes]
        if come:
            regressors = regressors.taking(np.concatenate(come))
        return Screening(regressors.only(_besides(regressors.candidates, causes)))

    def apart(self, gone: Sequence[H]) -> Screening[H]:
        """Test all candidates in the place of some causes, the others staying in the model."""
        return self.tested_with([cause for cause in self.causes if cause not in gone])

    def rise(self, gone: Sequence[H]) -> float:
        """Return by how much the cost would rise without some causes: each is taken out beside those that are left."""
        return -sum(self._cost(gone[: k + 1], cause) for k, cause in enumerate(gone))

    def expected(self, causes: Sequence[H]) -> float:
        """Return by how much the cost would rise with other causes instead; linear, without a refit.

        New ones are weighed one by one: this is for one at most. A form that is no candidate counts as the best of its place.
        """
        gone = [cause for cause in self.causes if cause not in causes]
        return self.rise(gone) + sum(self._cost(gone, cause) for cause in causes if cause not in self.causes)

    def _cost(self, gone: Sequence[H], cause: H) -> float:
        """Return the cost of a cause where others are taken out; none where it does not show."""
        apart = self.apart(gone)
        there = [c for c in apart.regressors.candidates if c.cause.place == cause.place]
        scores = Screening(apart.regressors.only(there)).scores
        own = [score.cost for score in scores if score.cause == cause]
        return min(own or (score.cost for score in scores), default=0.0)

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


WITHIN = 10.0  # of the least cost: closer rivals cannot be told apart (Kass and Raftery 1995: "very strong" beyond)
REACH = 7.0  # in the logarithm: a model this much less likely than what was found has a chance of 0.1 %
PATIENCE = 3  # models with causes at the same places that may be no better than one before them
BETTER = 1.0  # of cost: by how much one must be better to count as that


@dataclass(frozen=True)
class Trial(ABC, Generic[H]):
    """A model that was tried.

    family is what tests cost, degrees_of_freedom what the model without causes leaves, both of the first screening; missed is by
    how much its cost differs from what the linearised model before it let expect.
    """

    family: Family
    degrees_of_freedom: float
    missed: float = field(default=0.0, kw_only=True)

    @property
    @abstractmethod
    def causes(self) -> tuple[H, ...]:
        """Its causes."""

    @property
    @abstractmethod
    def cost(self) -> float:
        """What it costs, to be compared with other trials: see `refitted_cost`."""

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

    def weighed_in_place(self, finding: Detection[H]) -> Detection[H]:
        """Return a finding, its near rivals weighed by what they do where the cause does not act: that may be nothing."""
        return finding

    def refined(self) -> Iterator[list[H]]:
        """Yield the causes in forms that are clearly better, now that the others are in the model."""
        yield from ()

    @cached_property
    def findings(self) -> tuple[Detection[H], ...]:
        """Its causes, each weighed against all candidates in its place."""
        return tuple(self.linearisation.findings(self.family)) if self.causes else ()


def refitted_cost(
    misfit: float, degrees_of_freedom: float, fitted: Sequence[Amplitudes], log_determinant: float
) -> float:
    """Return twice minus the logarithm of a refitted model's evidence, to be compared with others' of the same data.

    The causes' amplitudes are integrated out by Laplace's approximation; a model's own parameters are common to all.

    Args:
        misfit: what the model leaves of chi², without what the causes pull at their own priors.
        degrees_of_freedom: of what the model without causes leaves, as in `log_likelihood`.
        fitted: the causes' amplitudes.
        log_determinant: of the covariance of the amplitudes that are off their bounds, over their usual sizes.
    """
    by_prior = sum(amplitudes.cost(degrees_of_freedom) for amplitudes in fitted)
    return degrees_of_freedom * float(np.log(misfit)) + by_prior - log_determinant


@dataclass(frozen=True)
class Amplitudes:
    """What a refit says of a cause's amplitudes: squared estimates over their usual sizes, how many are free and how many held.

    variants is how many forms of the cause were tried. What sits at a bound has no effect; it was there to be fitted, and counts
    as by BIC (Schwarz 1978).
    """

    pulled: float
    free: int
    held: int
    variants: int

    @staticmethod
    def of(offset: np.ndarray, sd: np.ndarray, at_bound: np.ndarray, variants: int) -> Amplitudes:
        """Return those of estimates so far from their priors' means, with these usual sizes, (n,) each; at_bound are held."""
        free = ~at_bound
        pulled = float(((offset[free] / sd[free]) ** 2).sum())
        return Amplitudes(pulled, int(free.sum()), int(at_bound.sum()), variants)

    def cost(self, degrees_of_freedom: float) -> float:
        """Return twice minus the logarithm of what they are by the prior."""
        held = self.held * float(np.log(degrees_of_freedom))
        return size_cost(self.pulled, self.free) + held + 2 * float(np.log(self.variants))


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
    costs = [trial.cost for trial in tried if sorted(cause.place for cause in trial.causes) == where]
    stuck = len(costs) > PATIENCE and min(costs[-PATIENCE:]) > min(costs[:-PATIENCE]) - BETTER
    return not stuck and is_new(causes, tried)


def swapped(causes: Sequence[H], gone: H, come: H) -> list[H]:
    """Return the causes with one in the place of another."""
    return [come if cause == gone else cause for cause in causes]


SHARES = {"causes": 0.7, "remainder": 0.2, "noise": 0.1}  # of the false alarms that are allowed


@dataclass(frozen=True)
class CauseAcceptance:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int

    def accepts(self, score: Score, family: Family) -> bool:
        """Whether a candidate pays, matters, and is no accident."""
        return score.cost < 0 and score.share > family.material and family.p(score) < self.false_alarm

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


FEW_COLUMNS = 4  # of a candidate at most: error maps have rivals of their own
BEST_VARIANTS = 8  # of one place, the best
SPLIT = 10.0  # of cost: by how much two must explain the data better than one (Kass and Raftery 1995: "very strong")


@dataclass(frozen=True)
class Pair(Generic[H]):
    """Two candidates together; p is the larger of their family-wise p-values, each beside the other."""

    first: Score[H]
    second: Score[H]
    cost: float
    p: float


@dataclass(frozen=True)
class Exchange(Generic[H]):
    """All pairs of candidates in the place of one cause or two, small ones only.

    information (m, m, COLUMNS, COLUMNS) is S between candidates in units of the priors and score (m, COLUMNS) their u, filled
    up with zeros, which explain nothing and cost nothing.
    """

    screening: Screening[H]
    family: Family
    gone: Sequence[H]
    scores: tuple[Score[H], ...]
    information: np.ndarray
    score: np.ndarray

    @staticmethod
    def of(screening: Screening[H], family: Family, gone: Sequence[H]) -> Exchange[H]:
        """Take the best variants of every place, and the causes that are gone."""
        seen: Counter[tuple[str, str]] = Counter()
        few = []
        for score in screening.scores:
            seen[score.cause.place] += 1
            best = seen[score.cause.place] <= BEST_VARIANTS and len(score.candidate.columns) <= FEW_COLUMNS
            if best or score.cause in gone:
                few.append(score)
        columns = np.zeros((len(few), FEW_COLUMNS), dtype=int)
        sd = np.zeros(columns.shape)
        for k, score in enumerate(few):
            span = score.candidate.columns
            columns[k, : len(span)] = span
            sd[k, : len(span)] = screening.regressors.prior_sd[span]
        used, which = np.unique(columns, return_inverse=True)
        which = which.ravel()
        information = screening.information(used)[np.ix_(which, which)] * sd.ravel()[:, None] * sd.ravel()
        shape = (len(few), FEW_COLUMNS, len(few), FEW_COLUMNS)
        return Exchange(
            screening, family, gone, tuple(few), information.reshape(shape).transpose(0, 2, 1, 3),
            screening.score[columns] * sd,
        )  # fmt: skip

    def alone(self) -> Score[H] | None:
        """Return the best candidate that explains the data better than the two that are gone do together."""
        at = [k for k, score in enumerate(self.scores) if score.cause in self.gone]
        best = min(self.scores, key=lambda score: score.cost, default=None)
        if len(at) < 2 or best is None or not best.cost < self._costs[at[0], at[1]]:
            return None
        return best

    def better(self) -> Iterator[Pair[H]]:
        """Yield the pairs of different places that explain the data better than what they replace, best first."""
        at = [k for k, score in enumerate(self.scores) if score.cause in self.gone]
        if len(at) < len(self.gone):
            return  # what is gone does not show here
        every = self._costs
        now = every[at[0], at[1]] if len(at) == 2 else self.scores[at[0]].cost - SPLIT
        limit = now - self.family.material * self.screening.degrees_of_freedom
        cost = np.where(self._of_different_places, every, np.inf)
        for k in np.argsort(cost, axis=None, kind="stable"):
            i, j = (int(x) for x in np.unravel_index(k, cost.shape))
            if not cost[i, j] < limit:
                return
            yield Pair(self.scores[i], self.scores[j], float(cost[i, j]), max(self._p(i, j), self._p(j, i)))

    @property
    def _of_different_places(self) -> np.ndarray:
        """Which pairs are of two places, each pair once, shape (m, m)."""
        places = [score.cause.place for score in self.scores]
        number = {place: k for k, place in enumerate(dict.fromkeys(places))}
        where = np.array([number[place] for place in places])
        return np.triu(where[:, None] != where, 1)

    @cached_property
    def _costs(self) -> np.ndarray:
        """Return the cost of every pair, shape (m, m)."""
        identity = np.eye(FEW_COLUMNS)
        m, chi2 = len(self.scores), self.screening.chi2
        size, taken_for = self.likeliest_sizes
        information = self.information * size[:, None, None, None] * size[:, None, None]
        score, diagonal = self.score * size[:, None], information[np.arange(m), np.arange(m)]
        alone = np.linalg.inv(diagonal + identity)
        drop_alone = np.einsum("ma,mab,mb->m", score, alone, score)
        # What j shows beside i, and what is left for it to explain.
        taken = np.einsum("ijab,iac->ijbc", information, alone, optimize=True)
        beside = diagonal + identity - np.einsum("ijbc,ijcd->ijbd", taken, information, optimize=True)
        beside[np.arange(m), np.arange(m)] = identity
        left = score - np.einsum("ijbc,ic->ijb", taken, score, optimize=True)
        drop = drop_alone[:, None] + np.einsum("ijb,ijbc,ijc->ij", left, np.linalg.inv(beside), left, optimize=True)
        narrowed = np.linalg.slogdet(diagonal + identity)[1][:, None] + np.linalg.slogdet(beside)[1]
        spent = taken_for + 2 * np.log([self.screening.variants[score.cause.place] for score in self.scores])
        logs = log_likelihood(drop / chi2, narrowed, self.screening.degrees_of_freedom)
        return np.asarray(-2 * logs + spent[:, None] + spent)

    @property
    def likeliest_sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """The size over the usual one at which each candidate alone explains the data best (m,), and what it costs to take it."""
        at = np.arange(len(self.scores))
        fallen, narrowed = explained(*directions(self.information[at, at], self.score))
        logs = log_likelihood(fallen / self.screening.chi2, narrowed, self.screening.degrees_of_freedom)
        best = np.argmax(logs + LOG_PRIOR[:, None], axis=0)
        return SIZES[best], -2 * (mixed(logs) - logs[best, at])

    def _p(self, i: int, j: int) -> float:
        """Return the family-wise p-value of candidate j where i is in the model."""
        identity = np.eye(FEW_COLUMNS)
        taken = self.information[j, i] @ np.linalg.inv(self.information[i, i] + identity)
        values, vectors = np.linalg.eigh(self.information[j, j] - taken @ self.information[i, j])
        shown = values > INVISIBLE
        if not shown.any():
            return 1.0
        left = self.score[j] - taken @ self.score[i]
        drop = float((((vectors.T @ left)[shown]) ** 2 / values[shown]).sum())
        degrees_of_freedom = int(shown.sum())
        rest = max(self.screening.degrees_of_freedom - degrees_of_freedom, 1.0)
        chi2 = max(self.screening.chi2 - self.scores[i].drop - drop, 1e-12 * self.screening.chi2)
        single = float(scipy.special.fdtrc(degrees_of_freedom, rest, drop / degrees_of_freedom / (chi2 / rest)))
        return self.family.p(replace(self.scores[j], p=single))


DOUBT = 0.05  # share of a cause's evidence by which the linear comparison with a rival may err
WORTH = WITHIN  # of cost: smaller doubts do not decide anything

Place = tuple[str, str]


def doubtful(finding: Detection[H]) -> list[Score[H]]:
    """Return the best variants of the rivals that might explain the data as well, the nearest first; none of a small cause."""
    doubt = -DOUBT * finding.own.cost
    if doubt < WORTH:
        return []
    places = by_place(finding.scores)
    named_cost = places.pop(finding.cause.place)[0]
    near = [(cost, score) for cost, score in places.values() if cost - named_cost < WITHIN + doubt]
    return [score for _, score in sorted(near, key=lambda scored: scored[0])]


def doubted(best: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with a rival of a large one in its place, or without one that has another at its joint.

    Rivals, and what is left at a joint, are taken in the form that is best there.
    """
    small = [finding for finding in best.findings if finding.cause.n_parameters <= FEW_COLUMNS]
    for finding in small:
        cause = finding.cause
        for score in doubtful(finding):
            yield swapped(best.causes, cause, best.in_place([cause], score.cause))
        for other in (
            rival.cause for rival in small if rival.cause != cause and cause.joint and rival.cause.joint == cause.joint
        ):
            stay = [rival for rival in best.causes if rival != cause]
            yield stay
            yield swapped(stay, other, best.in_place([cause, other], other))


def verified(best: Trial[H], tried: Sequence[Trial[H]]) -> tuple[Detection[H], ...]:
    """Return the findings, with the rivals' evidence from the fits that there were with one of them in a cause's place."""
    detections = []
    for finding in map(best.weighed_in_place, best.findings):
        stay = [cause for cause in best.causes if cause != finding.cause]
        above = {
            score.cause.place: min(fitted)
            for score in doubtful(finding)
            if (fitted := [other.cost - best.cost for other in tried if _has(other, stay, score.cause)])
        }
        detections.append(corrected_rivals(finding, above, best.degrees_of_freedom))
    return tuple(detections)


def _has(trial: Trial[H], stay: Sequence[H], rival: H) -> bool:
    """Whether a trial had these causes and a rival besides, in any form."""
    others = [cause for cause in trial.causes if cause not in stay]
    return len(trial.causes) == len(stay) + 1 and [cause.place for cause in others] == [rival.place]


def corrected_rivals(finding: Detection[H], above: Mapping[Place, float], degrees_of_freedom: float) -> Detection[H]:
    """Return the finding with some places' costs as they were fitted, above that of the cause."""
    places = by_place(finding.scores)
    own_cost = places[finding.cause.place][0]
    shift = {place: cost + own_cost - places[place][0] for place, cost in above.items()}

    def moved(score: Score[H]) -> Score[H]:
        if score.cause.place not in shift:
            return score
        change = shift[score.cause.place]
        share = 1 - (1 - score.share) * float(np.exp(change / degrees_of_freedom))
        return replace(score, cost=score.cost + change, share=share, drop=share * score.drop / max(score.share, 1e-12))

    scores = sorted(map(moved, finding.scores), key=lambda score: score.cost)
    return replace(finding, scores=tuple(scores))


CLEAR = 1e-3  # share of the acceptance below which the cost of the tests need not be worked out anew
STEP_SHARE = 0.2  # share of what is left of the search that a step counts as: how many there will be, nobody knows
MOST_TRIALS = 60  # models that are fitted in all: a search that needs more goes round in circles
ENTANGLED = 3  # causes, the last found, that are exchanged by two


@dataclass(frozen=True)
class Proposal(Generic[H]):
    """What to try next, and why in words; added is the last cause's score, where it is new.

    expected is by how much the linearised model's cost rises with it, None where that was not worked out.
    """

    causes: list[H]
    words: str
    added: Score[H] | None = None
    expected: float | None = None


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

    def best(self, *start: Trial[H]) -> tuple[Trial[H], list[Trial[H]]]:
        """Return the best model and all that were tried, from the last there are: steps and exchanges, until nothing changes."""
        tried = list(start)
        best = self.settled(tried)
        while better := self.improved(best, tried):
            best = better
        if len(tried) >= MOST_TRIALS:
            self.say(f"the search ends after {MOST_TRIALS} models: there may be a better one")
        return best, tried

    def settled(self, tried: list[Trial[H]]) -> Trial[H]:
        """Add causes while one passes, drop or swap those that prove mistaken; return the best model whose causes all stand.

        A step that proves worse than was expected is taken back, and not tried again: from a model no more than one of each kind
        fails. tried grows by the models on the way.
        """
        begin, now = len(tried) - 1, tried[-1]
        while step := self._next(now, tried):
            self.say(step.words)
            tried.append(_moved(now, step))
            if tried[-1].cost < now.cost + BETTER or len(step.causes) < len(now.causes):
                now.forget()
                now = tried[-1]
            else:
                self.say("that is no better")
            self.advance(1 - (1 - STEP_SHARE) ** len(tried))
        best_first = sorted([tried[0], *tried[begin:]], key=lambda trial: trial.cost)
        best = next(trial for trial in best_first if self.stands(trial))
        forget_all_but(best, tried)
        return best

    def _next(self, now: Trial[H], tried: Sequence[Trial[H]]) -> Proposal[H] | None:
        """Return the next step from a trial; none where there is no more, or where there were enough."""
        if len(tried) >= MOST_TRIALS:
            return None
        return next((step for step in self._steps(now) if is_worth_trying(step.causes, tried)), None)

    def improved(self, best: Trial[H], tried: list[Trial[H]]) -> Trial[H] | None:
        """Return a better model that a merger, an exchange, or a rival in the place of a large cause leads to, if there is one."""
        others = _within_reach(best, doubted(best))
        at_once = chain(_within_reach(best, merged(best)), self.exchanges(best))
        return self._led_to(best, tried, at_once, lambda _: False) or self._led_to(
            best, tried, others, lambda trial: trial.cost < best.cost + WITHIN and not self.stands(trial)
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
            tried.append(_moved(best, step))
            if _cost_apart(tried[-1]) < _cost_apart(best) or promising(tried[-1]):
                self.say(step.words)
                if _cost_apart(other := self.settled(tried)) < _cost_apart(best):
                    return other
                self.say("that is no better")
            forget_all_but(best, tried)
        return None

    def stands(self, trial: Trial[H]) -> bool:
        """Whether each of a trial's causes would pass again."""
        return all(map(self.acceptance.keeps, trial.findings))

    def exchanges(self, trial: Trial[H]) -> Iterator[Proposal[H]]:
        """Yield the causes with one or two in the place of two, or two in that of one, where that explains the data better."""
        small = [cause for cause in trial.causes if cause.n_parameters <= FEW_COLUMNS][-ENTANGLED:]
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
    # The cost of one test: what does not pass at that passes at none.
    single = replace(now.family, scans={}, places=1.0)
    if trial.causes and doubtful and any(acceptance.accepts(score, single) for score in now.scores):
        now = trial.linearisation.screened(rng)  # what the tests cost depends on what is left, where it matters
        passed = [score for score in now.scores if acceptance.accepts(score, now.family)]
    if not passed:
        return
    best = trial.finest(min(passed, key=lambda score: score.cost))
    message = f"{words(best.cause)}: chi2 falls by {best.drop:.4g}, p = {now.family.p(best):.2g}"
    yield Proposal([*trial.causes, best.cause], message, best, best.cost)


def _replaced(trial: Trial[H], causes: list[H], expected: float | None = None) -> Proposal[H]:
    return Proposal(causes, _difference(trial.causes, causes), expected=expected)


def _within_reach(trial: Trial[H], others: Iterable[list[H]]) -> Iterator[Proposal[H]]:
    """Propose the sets of causes that may be better, or not clearly worse, as far as the linearised model can be trusted.

    It errs by a share of what is taken out, and it has erred by as much as it did in the step before.
    """
    for causes in others:
        gone = [cause for cause in trial.causes if cause not in causes]
        doubt = max(DOUBT * trial.linearisation.rise(gone), trial.missed)
        expected = trial.linearisation.expected(causes)
        if expected < WITHIN * max(1, len(trial.causes) - len(causes)) + doubt:
            yield _replaced(trial, causes, expected)


def _moved(trial: Trial[H], step: Proposal[H]) -> Trial[H]:
    """Fit a step from a trial."""
    moved = trial.with_causes(step.causes, step.added)
    missed = trial.missed if step.expected is None else abs(moved.cost - trial.cost - step.expected)
    return replace(moved, missed=missed)


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
    weakest = sorted(findings, key=lambda finding: -_own_cost(finding))
    for finding in weakest:
        if not acceptance.keeps(finding):
            return [cause for cause in causes if cause != finding.cause]
    for finding in weakest:
        places = by_place(finding.scores)
        cost, best = min(places.values(), key=lambda scored: scored[0])
        if cost < places[finding.cause.place][0] and acceptance.accepts(best, finding.family):
            return swapped(causes, finding.cause, best.cause)
    return causes


def _cost_apart(trial: Trial[H]) -> float:
    """What it costs, where two causes must explain the data clearly better than one does."""
    return trial.cost + SPLIT * len(trial.causes)


def _own_cost(finding: Detection[H]) -> float:
    return next((score.cost for score in finding.scores if score.cause == finding.cause), 0.0)
