"""Verification: rivals of a large cause are fitted in its place, where one linearisation is not exact enough to exclude them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calflow.stages.look import Finding
from calflow.stages.screening import Score, by_place
from calflow.stages.verdict import WITHIN

DOUBT = 0.05  # share of a cause's evidence by which the linear comparison with a rival may err
WORTH = WITHIN  # of BIC: smaller doubts do not decide anything

Place = tuple[str, str]


def doubtful(finding: Finding) -> list[Score]:
    """Return the best variants of the rivals that might explain the data as well, the nearest first; none of a small cause."""
    doubt = -DOUBT * finding.own.delta_bic
    if doubt < WORTH:
        return []
    places = by_place(finding.scores)
    own = places.pop(finding.cause.place)[0]
    near = [(bic, score) for bic, score in places.values() if bic - own < WITHIN + doubt]
    return [score for _, score in sorted(near, key=lambda one: one[0])]


def corrected(finding: Finding, above: Mapping[Place, float], n: int) -> Finding:
    """Return the finding with some places' BICs as they were fitted, above that of the cause; n is the number of residuals."""
    places = by_place(finding.scores)
    own = places[finding.cause.place][0]
    shift = {place: bic + own - places[place][0] for place, bic in above.items()}

    def moved(score: Score) -> Score:
        if score.cause.place not in shift:
            return score
        change = shift[score.cause.place]
        share = 1 - (1 - score.share) * float(np.exp(change / n))
        return replace(
            score, delta_bic=score.delta_bic + change, share=share, drop=share * score.drop / max(score.share, 1e-12)
        )

    scores = sorted(map(moved, finding.scores), key=lambda score: score.delta_bic)
    return replace(finding, scores=tuple(scores))
