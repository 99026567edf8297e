"""Rivals of a large cause are fitted in its place before they are excluded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from calflow.diagnosis.screening import Family, by_place
from calflow.diagnosis.stepwise import corrected_rivals, doubted, doubtful, verified
from calflow.diagnosis.trial import Detection, Screened
from calflow.diagnosis.verdict import verdict
from diagnosis.test_verdict import score

N = 300
BEGUN = Screened((), Family({}, 1.0), N)


@dataclass(frozen=True)
class Seen:
    """A trial as verification sees it: what was found, what it costs, and the best form of every rival."""

    findings: tuple
    cost: float = 0.0
    forms: dict = field(default_factory=dict)
    first: Screened = BEGUN

    @property
    def causes(self):
        """Its causes."""
        return tuple(one.cause for one in self.findings)

    def in_place(self, gone, cause):
        """The best form in the place of what is gone."""
        return self.forms.get((cause.id, len(gone)), cause)

    def with_acting_rivals(self, finding):
        """What a rival does here depends on no other cause."""
        return finding

    def with_form_errors(self, finding):
        """Forms are exact here."""
        return finding


def finding(*scores):
    """A finding of the first one's cause."""
    return Detection(scores[0].cause, tuple(sorted(scores, key=lambda s: s.cost)), Family({}, 1.0))


def test_only_a_large_cause_leaves_doubts():
    """Breaks if every finding costs fits, or one that the linear comparison excludes by little is believed to be out."""
    small = finding(score(-90.0, "gravity-compensator", 2), score(-85.0, "joint-eccentricity", 2))
    assert doubtful(small) == []
    near, far = score(-960.0, "joint-eccentricity", 2), score(-800.0, "gear-ratio-error", 2)
    assert doubtful(finding(score(-1000.0, "gravity-compensator", 2), near, far)) == [near]


def test_a_fitted_rival_is_as_near_as_its_fit_says():
    """Breaks if the linear comparison decides although there is a fit, or what was not fitted moves."""
    own, other = score(-1000.0, "gravity-compensator", 2), score(-800.0, "gear-ratio-error", 2)
    rivals = [score(cost, "joint-eccentricity", 2, order=order) for cost, order in ((-960.0, 1), (-700.0, 2))]
    place = rivals[0].cause.place
    seen = finding(own, other, *rivals)
    assert verdict(seen).status == "named"
    now = corrected_rivals(seen, {place: 1.5}, N)
    (rival,) = verdict(now).rivals
    assert (rival.id, rival.cost) == ("joint-eccentricity", pytest.approx(1.5))
    places = by_place(now.scores)
    assert places[other.cause.place][0] == pytest.approx(-800.0)
    before, after = (next(s for s in one.scores if s.cause == rivals[0].cause) for one in (seen, now))
    assert N * np.log1p(-after.share) - N * np.log1p(-before.share) == pytest.approx(after.cost - before.cost)
    assert after.drop / after.share == pytest.approx(before.drop / before.share)


def test_a_rival_is_fitted_in_its_best_form():
    """Breaks if a rival is excluded in the form that the scan tried, or its fit in a better one does not count."""
    own, rival = score(-1000.0, "gear-ratio-error", 2), score(-960.0, "gravity-compensator", 2)
    best = score(-990.0, "gravity-compensator", 2, ratio=0.3, hinge=40.0).cause
    trial = Seen((finding(own, rival),), forms={("gravity-compensator", 1): best})
    assert list(doubted(trial)) == [[best]]
    (seen,) = verified(trial, [trial, Seen((finding(score(-990.0, best.id, 2, ratio=0.3, hinge=40.0)),), cost=-2.0)])
    assert by_place(seen.scores)[best.place][0] == pytest.approx(-1002.0)


def test_two_of_a_joint_may_be_one_in_another_form():
    """Breaks if what is left of two causes of a joint keeps the form that it had beside the other."""
    first, second = score(-90.0, "joint-eccentricity", 2), score(-80.0, "gravity-compensator", 2)
    best = score(-150.0, "gravity-compensator", 2, ratio=0.3, hinge=40.0).cause
    trial = Seen((finding(first), finding(second)), forms={("gravity-compensator", 2): best})
    tried = list(doubted(trial))
    assert [best] in tried
    assert [second.cause] in tried
    assert [first.cause] in tried
