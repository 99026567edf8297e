"""The models in reach of what was found, and what was assumed of them before the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.cause_tables import cause_table
from calflow.diagnosis.models_in_reach import models_in_reach, rivals_shown
from calflow.diagnosis.screening import Catalogue, Family, by_place
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.verdict import verdict
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from diagnosis.found import cause, hidden, start
from robots import industrial

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


@pytest.fixture(scope="module")
def found():
    """A model with the cause that was hidden, and what else could be there."""
    final = start(hidden([(ECCENTRIC, (6e-5, -3e-5))])).with_causes([ECCENTRIC])
    effects = tuple(catalogue()[name](industrial()) for name in ("gear-ratio-error", "joint-eccentricity"))
    every = Catalogue(effects, {})
    return final, Linearisation.at(final, every.effects), every


def test_one_cause_is_to_be_expected_of_the_whole_catalogue(found):
    """Fails if a larger catalogue does not make each of its causes dearer, or places that the data do not show count."""
    final, look, every = found
    findings = [look.finding(cause, Family({}, 1.0)) for cause in look.causes]
    first, *near = models_in_reach(final, findings, look.beside.scores, every)
    places = rivals_shown(findings, look.beside.scores)
    assert first.causes == final.causes
    assert first.change == "found"
    assert near
    for one in (first, *near):
        assert one.log_prior == pytest.approx(-len(one.causes) * np.log(len(places)))
        assert {c.place for c in one.causes} <= set(places)
    weights = [one.log_weight for one in near]
    assert weights == sorted(weights, reverse=True)


def test_the_same_probabilities_stand_in_findings_and_in_the_models(found):
    """Fails if a cause is weighed otherwise in a model than as a name, or doubts of two causes exclude each other."""
    final, look, every = found
    finding = look.finding(look.causes[0], Family({}, 1.0))
    own = by_place(finding.scores)[ECCENTRIC.place][0]
    rivals = [score for score in finding.scores if score.cause.place != ECCENTRIC.place]
    nearest = replace(rivals[0], cost=own + 1.0)
    far = [replace(score, cost=own + 40.0) for score in rivals[1:]]
    scores = (nearest, *far, *(score for score in finding.scores if score.cause.place == ECCENTRIC.place))
    doubted = replace(finding, scores=scores, unnamed=8.0)
    models = models_in_reach(final, [doubted], look.beside.scores, every)
    weights = np.exp([model.log_weight for model in models])
    having = [any(one.place == ECCENTRIC.place for one in model.causes) for model in models]
    stated = verdict(doubted).probability
    assert stated == pytest.approx(1 / (1 + np.exp(-0.5) + np.exp(-2.0)), abs=1e-3)
    assert weights[having].sum() / weights.sum() == pytest.approx(stated, abs=5e-3)


def test_a_curve_and_what_could_not_be_tested_stand_among_the_models():
    """Fails if a cause is certain in the models and one of several by its name: a curve, or one whose twin was not tested."""
    data = hidden([(ECCENTRIC, (6e-5, -3e-5)), (play := cause("torque-backlash", "joint2"), (3e-4,))])
    curve = Cause(data.robot, catalogue()["joint-error-map"].variants(data.robot, data)[0], "joint2")
    every = Catalogue((curve.effect, ECCENTRIC.effect, play.effect), {"joint-backlash": "approach"})
    final = start(data).with_causes([curve, play])
    look = Linearisation.at(final, every.effects)
    findings = [replace(look.finding(cause, Family({}, 1.0)), unnamed=30.0) for cause in look.causes]
    models = models_in_reach(final, findings, look.beside.scores, every)
    weights = np.exp([model.log_weight for model in models])
    for finding in findings:
        having = [finding.cause.place in {one.place for one in model.causes} for model in models]
        stated = verdict(finding, every.untestable(finding.cause.id)).probability
        assert weights[having].sum() / weights.sum() == pytest.approx(stated, abs=5e-3)
        assert stated < 0.95
    causes = cause_table(models).set_index(["cause", "part"])["probability"]
    assert causes["joint-backlash", "joint2"] == pytest.approx(causes["torque-backlash", "joint2"], abs=5e-3)


def test_doubts_of_two_causes_do_not_exclude_each_other():
    """Fails if only one of two uncertain causes can give way: each would look surer than it is."""
    other = cause("gear-ratio-error", "joint4")
    final = start(hidden([(ECCENTRIC, (6e-5, -3e-5)), (other, (1e-4,))])).with_causes([ECCENTRIC, other])
    every = Catalogue((ECCENTRIC.effect, other.effect), {})
    look = Linearisation.at(final, every.effects)
    findings = [replace(look.finding(cause, Family({}, 1.0)), unnamed=0.0) for cause in look.causes]
    models = models_in_reach(final, findings, look.beside.scores, every)
    weights = np.exp([model.log_weight for model in models])
    assert {model.change for model in models} >= {"found", "without", "several"}
    for finding in findings:
        having = [finding.cause in model.causes for model in models]
        assert weights[having].sum() / weights.sum() == pytest.approx(verdict(finding).probability, abs=5e-3)


def test_nothing_found_has_nothing_in_reach(found):
    """Fails if models are listed where diagnose found nothing."""
    final, _, every = found
    assert models_in_reach(final.with_causes([]), (), (), every) == ()
