"""Rivals that were fitted in a cause's place are weighed by their fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from calflow.diagnosis.screening import Family, by_place
from calflow.diagnosis.stepwise import Detection, corrected_rivals, verified
from calflow.diagnosis.verdict import verdict
from diagnosis.test_verdict import score

N = 300


@dataclass(frozen=True)
class Seen:
    """A trial as verification sees it: what was found, and what it costs."""

    findings: tuple
    cost: float = 0.0
    degrees_of_freedom: float = N

    @property
    def causes(self):
        """Its causes."""
        return tuple(one.cause for one in self.findings)


def finding(*scores):
    """A finding of the first one's cause."""
    return Detection(scores[0].cause, tuple(sorted(scores, key=lambda s: s.cost)), Family({}, 1.0))


def test_a_fitted_rival_is_as_near_as_its_fit_says():
    """Breaks if the linear comparison decides although there is a fit, or what was not fitted moves."""
    own, other = score(-1000.0, "gravity-compensator", 2), score(-800.0, "gear-ratio-error", 2)
    rivals = [score(cost, "joint-eccentricity", 2, order=order) for cost, order in ((-960.0, 1), (-700.0, 2))]
    seen = finding(own, other, *rivals)
    assert verdict(seen).status == "named"
    now = corrected_rivals(seen, {rivals[0].cause: 1.5}, N)
    (rival,) = verdict(now).rivals
    assert (rival.id, rival.cost) == ("joint-eccentricity", pytest.approx(1.5))
    places = by_place(now.scores)
    assert places[other.cause.place][0] == pytest.approx(-800.0)
    before, after = (next(s for s in one.scores if s.cause == rivals[0].cause) for one in (seen, now))
    assert N * np.log1p(-after.share) - N * np.log1p(-before.share) == pytest.approx(after.cost - before.cost)
    assert after.drop / after.share == pytest.approx(before.drop / before.share)


def test_a_rival_that_was_fitted_is_weighed_by_its_best_fit():
    """Breaks if a fit with a rival in a cause's place is forgotten, or one with another cause besides is taken for it."""
    own, rival = score(-1000.0, "gear-ratio-error", 2), score(-960.0, "gravity-compensator", 2)
    other = score(-50.0, "joint-eccentricity", 3)
    best = Seen((finding(own, rival),))
    tried = [
        best,
        *(Seen((finding(rival),), cost=cost) for cost in (3.0, -2.0)),
        Seen((finding(rival), finding(other)), -9.0),
    ]
    (seen,) = verified(best, tried)
    assert by_place(seen.scores)[rival.cause.place][0] == pytest.approx(-1002.0)
