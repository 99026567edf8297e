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
from calflow.diagnosis.search.cross_validation import blocks, carried_over
from calflow.diagnosis.search.exchange import SPLIT
from calflow.diagnosis.search.extension import Extended, extended
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.fitted_trial import FittedTrial
from calflow.diagnosis.search.linearisation import Finding, Linearisation
from calflow.diagnosis.search.stepwise import Stepwise, words
from calflow.diagnosis.search.trial import Trial, same
from calflow.diagnosis.search.unnamed import unnamed
from calflow.effects.cause import Cause

ROUNDS = 6  # in which causes and background settle


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
    now = found
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
        if same(now.fitted.causes, beside.causes):
            break
    else:
        against = unnamed(now.fitted, basis, catalogue.variants)
    fitted = replace(now.fitted, possible=possible(now.fitted, basis))
    return replace(now, fitted=fitted, findings=_judged(now, against))


def _weakest(fitted: Fitted, against: dict[Cause, float]) -> Cause | None:
    """The cause that a background explains best in its place, or that does not carry over, if there is one."""
    weakest = min(against, key=lambda cause: against[cause], default=None)
    if weakest is None or against[weakest] < 0:
        return weakest
    kinds = blocks(fitted)
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
    best = search.settled(tried)
    for trial in known:
        more = len(best.causes) - len(trial.causes)
        if more > 0 and search.stands(trial) and best.bic > trial.bic - SPLIT * more:
            best = trial  # two that together are what one was: as in an exchange, they must be clearly better
    return replace(extended(best, tried, first), first=found.first)


def _judged(found: Extended, against: dict[Cause, float]) -> tuple[Finding[Cause], ...]:
    kinds = blocks(found.fitted)
    return tuple(
        replace(
            finding,
            unnamed=against[finding.cause],
            carries_over=carried_over(found.fitted, finding.cause, kinds).holds,
        )
        for finding in found.findings
    )
