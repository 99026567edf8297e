"""Verification: rivals of a large cause are fitted in its place, where one linearisation is not exact enough to exclude them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calflow.diagnosis.findings.verdict import WITHIN
from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import by_place
from calflow.diagnosis.search.exchange import COLUMNS
from calflow.diagnosis.search.linearisation import Finding
from calflow.diagnosis.search.trial import Trial, swapped

DOUBT = 0.05  # share of a cause's evidence by which the linear comparison with a rival may err
WORTH = WITHIN  # of BIC: smaller doubts do not decide anything

Place = tuple[str, str]


def doubtful(finding: Finding[H]) -> list[Score[H]]:
    """Return the best variants of the rivals that might explain the data as well, the nearest first; none of a small cause."""
    doubt = -DOUBT * finding.own.delta_bic
    if doubt < WORTH:
        return []
    places = by_place(finding.scores)
    own = places.pop(finding.cause.place)[0]
    near = [(bic, score) for bic, score in places.values() if bic - own < WITHIN + doubt]
    return [score for _, score in sorted(near, key=lambda one: one[0])]


def doubted(best: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with a rival of a large one in its place, or without one that has another at its joint.

    Rivals, and what is left at a joint, are taken in the form that is best there.
    """
    small = [finding for finding in best.findings if finding.cause.n_parameters <= COLUMNS]
    for finding in small:
        cause = finding.cause
        for score in doubtful(finding):
            yield swapped(best.causes, cause, best.in_place([cause], score.cause))
        for other in (
            one.cause for one in small if one.cause != cause and cause.joint and one.cause.joint == cause.joint
        ):
            stay = [one for one in best.causes if one != cause]
            yield stay
            yield swapped(stay, other, best.in_place([cause, other], other))


def verified(best: Trial[H], tried: Sequence[Trial[H]]) -> tuple[Finding[H], ...]:
    """Return the findings, with the rivals' evidence from the fits that there were with one of them in a cause's place."""
    found = []
    for finding in best.findings:
        stay = [cause for cause in best.causes if cause != finding.cause]
        above = {
            score.cause.place: min(fitted)
            for score in doubtful(finding)
            if (fitted := [other.bic - best.bic for other in tried if _has(other, stay, score.cause)])
        }
        found.append(corrected(finding, above, best.n_residuals))
    return tuple(found)


def _has(trial: Trial[H], stay: Sequence[H], rival: H) -> bool:
    """Whether a trial had these causes and a rival besides, in any form."""
    others = [cause for cause in trial.causes if cause not in stay]
    return len(trial.causes) == len(stay) + 1 and [cause.place for cause in others] == [rival.place]


def corrected(finding: Finding[H], above: Mapping[Place, float], n: int) -> Finding[H]:
    """Return the finding with some places' BICs as they were fitted, above that of the cause; n is the number of residuals."""
    places = by_place(finding.scores)
    own = places[finding.cause.place][0]
    shift = {place: bic + own - places[place][0] for place, bic in above.items()}

    def moved(score: Score[H]) -> Score[H]:
        if score.cause.place not in shift:
            return score
        change = shift[score.cause.place]
        share = 1 - (1 - score.share) * float(np.exp(change / n))
        return replace(
            score, delta_bic=score.delta_bic + change, share=share, drop=share * score.drop / max(score.share, 1e-12)
        )

    scores = sorted(map(moved, finding.scores), key=lambda score: score.delta_bic)
    return replace(finding, scores=tuple(scores))
