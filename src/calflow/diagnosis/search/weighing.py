"""Weighing: every cause that was found against what nobody can name, which is a rival of each.

The search takes what it has not found yet for independent noise. Here it is a background (see `background`): what rows near each
other share. A cause has to explain the data better than the background does that takes its place, to show more beside it than
chance would in all its family, and to carry over to blocks of training poses that were left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.acceptance import Acceptance
from calflow.diagnosis.search.background import Basis, background, possible
from calflow.diagnosis.search.cross_validation import carried_over, left_out
from calflow.diagnosis.search.exchange import SPLIT
from calflow.diagnosis.search.extension import Extended, extended
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.fitted_trial import FittedTrial
from calflow.diagnosis.search.linearisation import Finding, Linearisation
from calflow.diagnosis.search.stepwise import Stepwise, second_thoughts, words
from calflow.diagnosis.search.trial import Trial, is_new, same
from calflow.diagnosis.search.unnamed import evidence, unnamed
from calflow.effects.cause import Cause

ROUNDS = 6  # in which causes and background settle
THOUGHTS = 3  # rivals that may take a cause's place one after another


def weighed(
    start: Fitted,
    found: Extended,
    catalogue: Catalogue,
    acceptance: Acceptance,
    rng: np.random.Generator,
    say: Callable[[str], None],
) -> Extended:
    """Drop and exchange causes that do not hold beside a background of the size that is left, until they agree with it."""
    basis = Basis.of(start)
    now, rounds = found, list[Extended]()
    for _ in range(ROUNDS):
        against = unnamed(now.fitted, basis, catalogue.variants)
        while weakest := _weakest(now.fitted, against):
            say(f"{words(weakest)} gives way to what nobody can name")
            fitted = replace(now.fitted, background=None)
            now = replace(now, fitted=fitted.with_causes([cause for cause in fitted.causes if cause != weakest]))
            against = unnamed(now.fitted, basis, catalogue.variants)
        left = background(now.fitted, basis)
        if left is not None:
            say(
                f"left over, by {', '.join(' and '.join(inputs) for inputs in left.inputs)}: what is found is held against it"
            )
        beside = replace(now.fitted, background=left)
        now = _searched(replace(start, background=left), beside, found, catalogue, acceptance, rng, say)
        rounds.append(now)
        if same(now.fitted.causes, beside.causes):
            break
        if any(same(now.fitted.causes, other.fitted.causes) for other in rounds[:-1]):
            now = min(
                rounds, key=lambda one: evidence(one.fitted, basis, catalogue.variants)
            )  # they go round in circles
            break
    if not same(list(against), now.fitted.causes):
        against = unnamed(now.fitted, basis, catalogue.variants)
    fitted = replace(now.fitted, possible=possible(now.fitted, basis))
    return replace(now, fitted=fitted, findings=_judged(now, against))


def _weakest(fitted: Fitted, against: dict[Cause, float]) -> Cause | None:
    """The cause that a background explains best in its place, or that does not carry over, if there is one."""
    weakest = min(against, key=lambda cause: against[cause], default=None)
    if weakest is None or against[weakest] < 0:
        return weakest
    kinds = left_out(fitted)
    failing = [cause for cause in against if not carried_over(fitted, cause, kinds).holds]
    return min(failing, key=lambda cause: against[cause], default=None)


def _searched(
    start: Fitted,
    beside: Fitted,
    found: Extended,
    catalogue: Catalogue,
    acceptance: Acceptance,
    rng: np.random.Generator,
    say: Callable[[str], None],
) -> Extended:
    """Search on from a model with its background."""
    family = found.first.family
    first = found.first
    if not beside.causes and start.background is not None:
        first = Linearisation.at(start, catalogue).screened(rng, family)
    known = [FittedTrial(family, beside, catalogue)] if beside.causes else []
    tried: list[Trial[Cause]] = [FittedTrial(family, start, catalogue), *known]
    search = Stepwise(acceptance, first, rng, say, lambda share: None)
    best = _second_thought(search.settled(tried), tried, search)
    for trial in known:
        more = len(best.causes) - len(trial.causes)
        if more > 0 and search.stands(trial) and best.bic > trial.bic - SPLIT * more:
            best = trial  # two that together are what one was: as in an exchange, they must be clearly better
    return replace(extended(best, tried, first), first=found.first)


def _second_thought(best: Trial[Cause], tried: list[Trial[Cause]], search: Stepwise[Cause]) -> Trial[Cause]:
    """The best model, or the one with a rival in the place of a cause that the background explains nearly as well.

    BIC of fits takes the background's size for known; the rivals' comparison in a cause's place does not.
    """
    for _ in range(THOUGHTS):
        wanted = second_thoughts(best.findings, search.acceptance)
        if same(best.causes, wanted):
            break
        if is_new(wanted, tried):
            tried.append(best.with_causes(wanted))
        (trial,) = (trial for trial in tried if same(trial.causes, wanted))
        if not search.stands(trial):
            break
        best = trial
    return best


def _judged(found: Extended, against: dict[Cause, float]) -> tuple[Finding[Cause], ...]:
    kinds = left_out(found.fitted)
    return tuple(
        replace(
            finding,
            unnamed=against[finding.cause],
            carries_over=carried_over(found.fitted, finding.cause, kinds).holds,
        )
        for finding in found.findings
    )
