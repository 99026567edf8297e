"""Refinement: a cause with an inner unknown (an order, a moment, a time constant) between its neighbours in the scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import Screening
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.linearisation import Linearisation
from calflow.diagnosis.search.trial import swapped
from calflow.effects.cause import Cause

STEPS = 4  # at most, of one inner unknown each, when a rival is refined before it is fitted
CLEARLY_FINER = 2.0  # of BIC: by how much a variant must be better than its neighbour for another fit


def finest(score: Score[Cause], now: Fitted) -> Score[Cause]:
    """Return the best variant of a cause that is not in the model yet."""
    finer = _finer(score.cause, now)
    if not finer:
        return score
    scores = Screening(now.regressors(finer)).scores
    best = max(scores, key=lambda s: s.drop, default=score)
    return best if best.drop > score.drop else score


def refined(now: Fitted) -> Iterator[list[Cause]]:
    """Yield a model's causes with one in a variant that is clearly better, now that the others are in the model."""
    finer = [_finer(cause, now) for cause in now.causes]
    if not any(finer):
        return
    linearisation = Linearisation.at(now, Catalogue(tuple(chain.from_iterable(finer)), {}))
    for cause in (cause for cause, found in zip(now.causes, finer, strict=True) if found):
        near = [score for score in linearisation.apart([cause]).scores if score.cause.place == cause.place]
        own = next((score.delta_bic for score in near if score.cause == cause), np.inf)
        if near and near[0].delta_bic < own - CLEARLY_FINER:
            yield swapped(now.causes, cause, near[0].cause)


def in_place(now: Fitted, gone: Sequence[Cause], cause: Cause) -> Cause:
    """Return the form of a cause that is best in the place of others, from the best that was tried by steps that are better."""
    for _ in range(STEPS):
        finer = _finer(cause, now)
        if not finer:
            return cause
        scores = Linearisation.at(now, Catalogue((cause, *finer), {})).apart(gone).scores
        best = next((score.cause for score in scores if score.cause.place == cause.place), cause)
        if best == cause:
            return cause
        cause = best
    return cause


def _finer(cause: Cause, now: Fitted) -> list[Cause]:
    return [replace(cause, effect=effect) for effect in cause.effect.finer(now.data)]
