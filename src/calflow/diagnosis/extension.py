"""The extension: a robot's model with causes by stepwise search, each compared with an unnamed error.

The search first takes errors as independent, then as correlated by a background (see `background`). A cause has to explain the
data better than the background that would replace it, to be significant beside it over its whole family, and to carry over to
left-out blocks of training poses (see `cross_validation`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from calflow.diagnosis.background import (
    JOINTS,
    BackgroundBasis,
    Sizes,
    Varying,
    background,
    beside_background,
    uneven_causes,
    uneven_or_other_forms,
)
from calflow.diagnosis.cross_validation import carrying
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.form_error import farthest, with_form_errors
from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Place
from calflow.diagnosis.screening import Catalogue, Score, by_place
from calflow.diagnosis.stepwise import REACH, SPLIT, Stepwise, words
from calflow.diagnosis.trial import Detection, Linearisation, Trial
from calflow.effects.cause import Cause
from calflow.estimation.fit import Fit
from calflow.estimation.variance_components import refitted_cost, spent

FINER_STEPS = 4  # refinements at most, of one inner unknown each
CLEARLY_FINER = 2.0  # least decrease of cost of a variant against its neighbour for another fit


@dataclass(frozen=True)
class FittedTrial(Trial[Cause]):
    """A trial whose model is fitted by IPOPT, with the catalogue of its candidates."""

    fitted: Fitted
    catalogue: Catalogue

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.fitted.causes

    @cached_property
    def linearisation(self) -> Linearisation[Cause]:
        return Linearisation.at(self.fitted, self.catalogue.effects)

    @cached_property
    def cost(self) -> float:
        """Minus twice the log evidence, comparable between trials: misfit, parameters, and number of variants tried."""
        fitted, model, free = self.fitted, self.fitted.model, np.flatnonzero(~self.fitted.fit.at_bound)
        settled = LinearModel(fitted.beside)
        estimate = fitted.fit.estimate.copy()
        estimate[free] += settled.change
        every = [_relative_amplitudes(fitted, cause, estimate, self.catalogue.variants) for cause in self.causes]
        columns = np.concatenate([np.zeros(0, dtype=int), *(model.columns(cause) for cause in self.causes)])
        shown = np.flatnonzero(np.isin(free, columns))
        root = settled.root_covariance(shown) / model.prior_sd[free[shown]]
        chi2, narrowed = settled.chi2 + fitted.outlier_loss, float(np.linalg.slogdet(root.T @ root)[1])
        return refitted_cost(chi2, fitted.scale, self.first.degrees_of_freedom, every, narrowed)

    @cached_property
    def own_findings(self) -> tuple[Detection[Cause], ...]:
        """Its causes, each with the scores of its own place alone."""
        family = self.first.family
        return tuple(self.linearisation.finding(cause, family, [cause.place]) for cause in self.causes)

    def with_causes(self, causes: Sequence[Cause], added: Score[Cause] | None = None) -> FittedTrial:
        """Return the study's effects fitted with these causes, a new one started from its linear estimate."""
        if added is None:
            return replace(self, fitted=self.fitted.with_causes(causes))
        start = np.concatenate([self.fitted.fit.estimate, added.estimate])
        return replace(self, fitted=self.fitted.with_causes(causes, start, added.explained))

    def finest(self, score: Score[Cause]) -> Score[Cause]:
        """Return the score of a candidate's best form beside the causes, between its neighbours in the scan."""
        if not (finer := self._finer(score.cause)):
            return score
        near = Linearisation.at(self.fitted, (score.cause, *finer)).forms(self.causes, score.cause.place)
        return near[0] if near and near[0].cause != score.cause else score

    def refined(self) -> list[Cause]:
        """Return the causes, each in its best variant beside the present ones of the others, if that is clearly better."""
        now = list(self.causes)
        for _ in range(FINER_STEPS):
            before, finer = list(now), [self._finer(cause) for cause in now]
            moved = [cause for cause in now if cause not in self.causes]
            if not any(finer):
                break
            linearisation = Linearisation.at(self.fitted, (*moved, *chain.from_iterable(finer)))
            for k in (k for k, variants in enumerate(finer) if variants):
                near = linearisation.forms([cause for cause in now if cause != now[k]], now[k].place)
                own_cost = next((score.cost for score in near if score.cause == now[k]), np.inf)
                if near and near[0].cost < own_cost - CLEARLY_FINER:
                    now[k] = near[0].cause
            if set(before) == set(now):
                break
        return now

    @cached_property
    def findings(self) -> tuple[Detection[Cause], ...]:
        """Its causes, each with the scores of all candidates in its place: near rivals where it is zero.

        A mass moves the tool through a spring: beside the bending that it is to replace, it seems to explain the same, but without
        that spring it has no such effect.
        """
        return tuple(self._with_rivals_alone(finding, finding.cost + 2 * REACH) for finding in self._linear_findings)

    @cached_property
    def _linear_findings(self) -> list[Detection[Cause]]:
        every = (self.linearisation.finding(cause, self.first.family) for cause in self.causes)
        return [finding for finding in every if finding.is_shown]

    def _with_rivals_alone(self, finding: Detection[Cause], limit: float) -> Detection[Cause]:
        cause = finding.cause
        near = {place for place, (cost, _) in finding.places.items() if cost < limit} - {cause.place}
        if not near:
            return finding
        here = {*near, cause.place}
        ids = {effect_id for effect_id, _ in here}
        effects = [effect for effect in self.catalogue.effects if effect.id in ids]
        alone = Linearisation.at(self.fitted, effects, cause).apart([cause], here).scores
        places = by_place(alone)
        if cause.place not in places:  # another cause imitates it there, as a spring does a small mass
            return finding
        level = finding.cost - places[cause.place][0]
        rivals = [replace(score, cost=score.cost + level) for score in alone if score.cause.place in near]
        others = [score for score in finding.scores if score.cause.place not in near]
        return replace(finding, scores=tuple(sorted([*others, *rivals], key=lambda score: score.cost)))

    @property
    def weighed_findings(self) -> tuple[Detection[Cause], ...]:
        """Its findings, their rivals weighed with form errors, which takes some linearisations for each."""
        return tuple(
            with_form_errors(
                self._with_rivals_alone(finding, farthest(finding.cost)),
                self.fitted,
                self.linearisation.apart([finding.cause]).model.regressors,
            )
            for finding in self._linear_findings
        )

    def _finer(self, cause: Cause) -> list[Cause]:
        return [replace(cause, effect=effect) for effect in cause.effect.finer(self.fitted.data)]


def extend(start: Fitted, catalogue: Catalogue, search: Stepwise) -> FittedTrial:
    """Return the model with the causes that it lacks, by a stepwise search with independent errors."""
    first = Linearisation.at(start, catalogue.effects).screened(search.rng)
    return search.best(FittedTrial(first, start, catalogue))


def weighed_against(findings: Sequence[Detection[Cause]], wider: FittedTrial) -> tuple[Detection[Cause], ...]:
    """Return the findings with a wider catalogue's candidates as rivals: a cause excluded from the search may be the true one."""
    scores = {finding.cause: finding.scores for finding in wider.weighed_findings}
    return tuple(replace(finding, scores=scores.get(finding.cause, finding.scores)) for finding in findings)


def largest_first(findings: Sequence[Detection[Cause]], fit: Fit) -> list[Detection[Cause]]:
    """Return the findings by the rise of chi² without each; the search may come late to a large one, as after an exchange."""

    def explained(finding: Detection[Cause]) -> float:
        return fit.from_zero(fit.model.columns(finding.cause), fit.covariance)

    return sorted(findings, key=explained, reverse=True)


def unnamed(
    fitted: Fitted,
    basis: BackgroundBasis,
    variants: Mapping[Place, int],
    same_in: Callable[[Cause], Collection[str]] = lambda cause: cause.effect.smooth_in,
    varying: Varying = uneven_causes,
) -> dict[Cause, float]:
    """Return twice the log evidence of each cause against a background in its place, negative where that explains the data better.

    Each model has its own likeliest background; parameters are integrated out by Laplace's approximation, as the background's
    amplitudes are. A background along an input of which the cause is a general smooth function (same_in) would be the same
    without a name, and is no rival. varying returns how the causes' effects may vary beside the background.
    """
    evidence = dict[Cause, float]()
    for cause in fitted.causes:
        without = fitted.alone.without(*fitted.own(cause))
        other = Sizes.of(without, basis, fitted.problem, varying(fitted, cause))
        whole = Sizes.beside(fitted, basis, varying)
        lost, kept = (sizes.likeliest(other.components.total, same_in(cause)) for sizes in (other, whole))
        evidence[cause] = lost - kept - spent(*_relative_amplitudes(fitted, cause, fitted.fit.estimate, variants))
    return evidence


def _relative_amplitudes(
    fitted: Fitted, cause: Cause, estimate: np.ndarray, variants: Mapping[Place, int]
) -> tuple[np.ndarray, int, float]:
    """Return what `spent` asks of a cause: amplitudes over their prior deviations, nan at a bound, forms tried, and scale."""
    model, columns = fitted.model, fitted.model.columns(cause)
    sizes = (estimate[columns] - model.prior_mean[columns]) / model.prior_sd[columns]
    return np.where(fitted.fit.at_bound[columns], np.nan, sizes), variants.get(cause.place, 1), cause.scale


def weighed(
    start: Fitted, first: FittedTrial, basis: BackgroundBasis, catalogue: Catalogue, search: Stepwise
) -> tuple[FittedTrial, tuple[Detection[Cause], ...]]:
    """Return the trial of the extended model and its findings, after alternating between the causes found first and background.

    start is the model without them. Causes that the background explains better, or that do not carry over, are dropped, and the
    search continues from the others until nothing that it finds is left beside those that it began from.
    """
    begin, found = FittedTrial(first.first, start, catalogue), first.fitted
    searched, judged, last = set[frozenset[Cause]](), set[frozenset[Cause]](), frozenset[Cause]()
    while True:
        now = beside_background(found, basis)
        while weakest := _weakest(now, basis, catalogue.variants):
            search.say(f"{words(weakest)} gives way to an unexplained error")
            judged.add(frozenset(now.causes))
            now = now.with_causes([cause for cause in now.causes if cause != weakest])
        held = frozenset(now.causes)
        judged.add(held)
        if len(held) < len(found.causes):
            now = beside_background(now, basis)
        left = background(now, basis)
        beside = replace(begin, fitted=replace(now, background=left))
        # Where that has given way before, the search goes on beside the background.
        if (
            held not in searched
            and (instead := _named_instead(beside, basis, search))
            and held | {instead} not in judged
        ):
            search.say(f"{words(instead)} in the place of an unexplained error")
            found = now.with_causes([*now.causes, instead])
            continue
        if any(held <= begun for begun in searched) or _would_find_again(beside, last, search):
            ended = beside
            break
        searched.add(held)
        if left is not None and left.inputs:
            inputs = ", ".join(dict.fromkeys(map(" and ".join, left.inputs)))
            search.say(f"the residuals are smooth in {inputs}: causes are tested beside that")
        ended = _searched(replace(begin, fitted=replace(start, background=left, shared=now.shared)), beside, search)
        found, last = ended.fitted, frozenset(ended.causes)
        if last == held:
            break
    # A cause that was found beside a smaller background, or beside other causes, may hardly show beside these.
    while hidden := next((finding.cause for finding in ended.own_findings if not finding.is_shown), None):
        search.say(f"{words(hidden)} hardly shows beside the rest")
        ended = ended.with_causes([cause for cause in ended.causes if cause != hidden])
    against = unnamed(ended.fitted, basis, catalogue.variants, varying=uneven_or_other_forms)
    carries = dict(zip(against, carrying(ended.fitted, basis, against), strict=True)) if against else {}
    return ended, tuple(
        replace(finding, unnamed=against[finding.cause], carries_over=carries[finding.cause])
        for finding in ended.weighed_findings
    )


def _would_find_again(trial: FittedTrial, last: frozenset[Cause], search: Stepwise) -> bool:
    """Whether a search from a model would find, linear, what the last one ended with and has given way, and nothing else."""
    causes, gone = list(trial.causes), {cause.place for cause in last.difference(trial.causes)}
    if not gone or not last.issuperset(causes):
        return False
    while passed := search.acceptance.passing(trial.linearisation.tested_with(causes).scores, trial.first.family):
        if passed[0].cause.place not in gone:
            return False
        causes.append(passed[0].cause)
        gone.remove(causes[-1].place)
    return len(causes) > len(trial.causes)


def _named_instead(trial: FittedTrial, basis: BackgroundBasis, search: Stepwise) -> Cause | None:
    """Return the best candidate beside the field of the joints alone, where a trial's background has other parts.

    None where no candidate is significant, or there are as many causes as may be. Beside a background in time no step or drift of
    the device could be significant, nor what the payload does beside one by payload; the cause is then weighed against all parts.
    """
    left, fitted = trial.fitted.background, trial.fitted
    others = {name for part in left.inputs if part != JOINTS for name in part} if left else set[str]()
    if not others or len(trial.causes) >= search.acceptance.most:
        return None
    field = background(fitted, basis, others)
    tests = trial.linearisation.beside_another(field, fitted.problem.weight).beside
    passed = search.acceptance.passing(tests.scores, trial.first.family)
    return replace(trial, fitted=replace(fitted, background=field)).finest(passed[0]).cause if passed else None


def _weakest(fitted: Fitted, basis: BackgroundBasis, variants: Mapping[Place, int]) -> Cause | None:
    """Return the weakest cause that loses against a background, or else that does not carry over, if there is one."""
    against = unnamed(fitted, basis, variants, lambda cause: cause.effect.named_in())
    weakest = sorted(against, key=lambda cause: against[cause])
    if not weakest or against[weakest[0]] < 0:
        return next(iter(weakest), None)
    return next(
        (cause for cause, holds in zip(weakest, carrying(fitted, basis, weakest), strict=True) if not holds), None
    )


def _searched(begin: FittedTrial, beside: FittedTrial, search: Stepwise) -> FittedTrial:
    """Return the search continued from a model with its background; begin has no causes."""
    if not beside.causes and begin.fitted.background is not None:
        now = begin.linearisation.screened(search.rng, begin.first.family)
        begin = replace(begin, first=replace(begin.first, scores=now.scores))
    tried = [begin, beside] if beside.causes else [begin]
    best = search.settled(tried)
    more = len(best.causes) - len(beside.causes)
    if beside.causes and more > 0 and best.cost > beside.cost - SPLIT * more and search.stands(beside):
        best = beside  # as in an exchange, more causes must be clearly better
    return best
