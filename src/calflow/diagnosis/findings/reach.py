"""The models in reach of what was found: its causes, one of them left out, one exchanged, or one added."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.linearisation import Finding, Linearisation
from calflow.diagnosis.search.trial import swapped
from calflow.effects.cause import Cause
from calflow.estimation.calibrated import MANY
from calflow.estimation.occam_window import Change, ModelInReach

REACH = 7.0  # in the logarithm: a model this much less likely than what was found, by the linear tests, has a chance of 0.1 %
MOST = 24  # models: the likeliest


def models_in_reach(
    final: Fitted, findings: Sequence[Finding[Cause]], catalogue: Catalogue
) -> tuple[ModelInReach, ...]:
    """Return the models in reach, what was found first, then by how likely the linear tests make them; none of nothing found.

    Before the data each place of the catalogue that they can show is a cause with odds of one to the number of these places,
    and its forms share them evenly: one cause is to be expected of the whole catalogue, however large it is. Causes of very many
    parameters stay as they are in all models.
    """
    if not any(_is_small(finding.cause) for finding in findings):
        return ()
    beside = Linearisation.at(final, catalogue).beside.scores
    places = float(np.log(len(shown(findings, beside))))

    def log_prior(causes: Sequence[Cause]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    independent = final.background is None and final.alone.shared == 1
    near = [
        ModelInReach(tuple(causes), change, log_prior(causes), weight, independent)
        for causes, change, weight in _neighbours(final, findings, beside, places)
        if weight > -REACH
    ]
    found = ModelInReach(final.causes, "found", log_prior(final.causes), 0.0, independent)
    return (found, *sorted(near, key=lambda one: -one.log_weight)[: MOST - 1])


def shown(findings: Sequence[Finding[Cause]], beside: Sequence[Score[Cause]]) -> dict[tuple[str, str], Cause]:
    """Return the places that the data show, in place of what was found or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


def _neighbours(
    final: Fitted, findings: Sequence[Finding[Cause]], beside: Sequence[Score[Cause]], places: float
) -> Iterator[tuple[list[Cause], Change, float]]:
    """Yield the causes of all models one step away, the step, and the logarithm of how likely it makes them (BIC).

    What a form costs is in BIC already, what a place costs (its logarithm) is not.
    """
    causes = list(final.causes)
    for finding in findings:
        if not _is_small(finding.cause):
            continue
        own = finding.own.delta_bic
        yield [cause for cause in causes if cause != finding.cause], "without", own / 2 + places
        for score in finding.scores:
            if score.cause != finding.cause and _is_small(score.cause):
                yield swapped(causes, finding.cause, score.cause), "instead", (own - score.delta_bic) / 2
    for score in beside:
        if _is_small(score.cause):
            yield [*causes, score.cause], "besides", -score.delta_bic / 2 - places


def _is_small(cause: Cause) -> bool:
    return cause.n_parameters <= MANY
