"""The models in reach of what was found, and what was assumed of them before the data."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.screening import Catalogue, Family
from calflow.diagnosis.stepwise import Linearisation
from calflow.diagnosis.verdict import models_in_reach, rivals_shown
from calflow.effects import catalogue
from diagnosis.found import cause, hidden, start
from robots import industrial

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


@pytest.fixture(scope="module")
def found():
    """A model with the cause that was hidden, and what else could be there."""
    final = start(hidden([(ECCENTRIC, (6e-5, -3e-5))])).with_causes([ECCENTRIC])
    effects = tuple(catalogue()[name](industrial()) for name in ("gear-ratio-error", "joint-eccentricity"))
    every = Catalogue(effects, {})
    return final, Linearisation.at(final, every), every


def test_one_cause_is_to_be_expected_of_the_whole_catalogue(found):
    """Fails if a larger catalogue does not make each of its causes dearer, or places that the data do not show count."""
    final, look, every = found
    findings = look.findings(Family({}, 1.0))
    first, *near = models_in_reach(final, findings, every)
    places = rivals_shown(findings, look.beside.scores)
    assert first.causes == final.causes
    assert first.change == "found"
    assert near
    for one in (first, *near):
        assert one.log_prior == pytest.approx(-len(one.causes) * np.log(len(places)))
        assert {c.place for c in one.causes} <= set(places)
    weights = [one.log_weight for one in near]
    assert weights == sorted(weights, reverse=True)


def test_nothing_found_has_nothing_in_reach(found):
    """Fails if models are listed where diagnose found nothing."""
    final, _, every = found
    assert models_in_reach(final.with_causes([]), (), every) == ()
