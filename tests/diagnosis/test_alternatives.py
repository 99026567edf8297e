"""Alternatives: a prediction is as unsure as the choice of its model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.alternatives import MOST_FITTED, _forms_by_other_conditions, fitted_alternatives
from calflow.diagnosis.models_in_reach import ModelInReach
from calflow.diagnosis.screening import Family
from calflow.diagnosis.trial import Detection
from calflow.diagnosis.unexplained import UnexplainedStructure, share_unnamed
from calflow.diagnosis.verdict import Rival, verdict
from calflow.effects.cause import Cause
from calflow.effects.wording import UNEXPLAINED
from calflow.estimation.calibrated_model import Alternative, choice_errors, points_at
from calflow.estimation.model_tables import _alternative, alternative_models
from diagnosis.found import cause, hidden, start
from diagnosis.test_verdict import score

ECCENTRIC = cause("joint-eccentricity", "joint2", order=1)


@pytest.fixture(scope="module")
def final():
    """A fitted model with one cause."""
    return start(hidden([(ECCENTRIC, (4e-4, -2e-4))])).with_causes([ECCENTRIC])


def judged(*rivals):
    """A verdict on the cause with these rivals' cost above its own."""
    found = verdict(Detection(ECCENTRIC, (score(-50.0, "joint-eccentricity", 2, order=1),), Family({}, 1.0)))
    weight = 1 + sum(np.exp(-rival.cost / 2) for rival in rivals)
    return replace(found, rivals=rivals, probability=1 / weight)


def ratio(cost):
    """The rival gear ratio error of the same joint."""
    return Rival("gear-ratio-error", 2, cost, score(-50.0 + cost, "gear-ratio-error", 2))


def test_rivals_are_fitted_in_the_causes_place(final):
    """Fails if an alternative keeps the cause, an untestable or unlikely rival has a model, or nobody's name is left out."""
    verdicts = [judged(ratio(2.0), Rival(UNEXPLAINED, 0, 3.0, None), Rival("joint-backlash", 2, 0.0, None))]
    found = fitted_alternatives(verdicts, final)
    assert [tuple(c.id for c in one.model.effects if isinstance(c, Cause)) for one in found] == [
        (),
        ("gear-ratio-error",),
    ]
    p = verdicts[0].probability
    assert [one.probability for one in found] == pytest.approx([p * (1 + np.exp(-1.5)) / 2, p * np.exp(-1.0)])
    assert fitted_alternatives([judged(ratio(9.5))], final) == ()
    (likelier,) = fitted_alternatives([judged(ratio(-8.0))], final)
    assert likelier.probability == pytest.approx(1 / (1 + np.exp(-4.0)))  # a rival may be likelier than what was named
    assert len(fitted_alternatives([judged(*[ratio(0.1)] * (MOST_FITTED + 2))], final)) == MOST_FITTED


def test_what_cannot_be_told_from_an_unnamed_error_is_as_likely_one(final):
    """Fails if an unnamed error in a cause's place leaves its promise as it was, or its smooth errors as small as beside it."""
    as_good = judged(Rival(UNEXPLAINED, 0, 9.0, None))
    (without,) = fitted_alternatives([as_good], final)
    assert (without.gone, without.rival) == (ECCENTRIC, None)
    assert without.probability == pytest.approx((as_good.probability + as_good.of_unnamed) / 2)
    (shared,) = fitted_alternatives([judged()], final, unnamed={ECCENTRIC: 0.2})
    assert (shared.gone, shared.probability) == (ECCENTRIC, pytest.approx(0.2 * judged().probability))
    alone, gone = final.smooth.variance, final.smooth.without([ECCENTRIC]).variance
    unsure = replace(final, doubted={ECCENTRIC: without.probability})
    between = final.with_smooth_errors((alone + gone) / 2)[1]
    assert gone.sum() > alone.sum()
    assert unsure.errors.sd == pytest.approx(between.sd)


def test_a_cause_is_doubted_by_as_much_as_is_left_beside_it(final):
    """Fails if a little left along its input makes a gear that explains nearly all as likely absent, or more of its curve does."""
    own = replace(score(-50.0, "joint-eccentricity", 2, order=1), share=0.8)
    found, left = Detection(ECCENTRIC, (own,), Family({}, 1.0)), UnexplainedStructure(("q2", "q5"), 1e-9, 0.5, ())
    assert share_unnamed(found, final.model, [left]) == pytest.approx(
        0.1 / 0.9
    )  # of chi² that the cause had left over, half
    assert share_unnamed(found, final.model, [replace(left, along=("q2",))]) == 0
    assert share_unnamed(found, final.model, [replace(left, inputs=("q3",))]) == 0


def test_a_probable_cause_beside_those_found_is_an_alternative(final):
    """Fails if a cause too small to be named shifts no prediction, or one does that hardly anything speaks for."""
    found = ModelInReach((ECCENTRIC,), "found", 0.0, 0.0)
    probable, improbable = (
        ModelInReach((ECCENTRIC, cause("gear-ratio-error", f"joint{joint}")), "besides", 0.0, weight)
        for joint, weight in ((3, 0.5), (4, -4.0))
    )
    (other,) = fitted_alternatives([judged()], final, in_reach=(found, probable, improbable))
    assert [(c.id, c.joint) for c in other.model.effects if isinstance(c, Cause)] == [
        ("joint-eccentricity", 2),
        ("gear-ratio-error", 3),
    ]
    assert (other.gone, other.rival) == (None, probable.causes[-1])
    assert other.probability == pytest.approx(np.exp(0.5) / (1 + np.exp(0.5) + np.exp(-4.0)))


def test_forms_by_other_conditions_are_alternatives(final):
    """Fails if forms by one clock are fitted side by side, or one by another counts for itself alone, or however improbable."""
    costs = {1800.0: -50.0, 3600.0: -49.0, 0.0: -48.0}
    scores = tuple(score(cost, "thermal-growth", constant=constant) for constant, cost in costs.items())
    model = replace(final.model, given=("time", "temperature"))

    def others(own):
        found = verdict(Detection(scores[own].cause, scores, Family({}, 1.0)))
        return _forms_by_other_conditions(found, model), found.probability

    share = np.exp(-np.array(list(costs.values())) / 2)
    share /= share.sum()
    by_temperature, p = others(0)
    assert by_temperature == [(pytest.approx(p * share[2]), scores[2].cause)]
    by_time, p = others(2)
    assert by_time == [(pytest.approx(p * share[:2].sum()), scores[0].cause)]
    costs[0.0] = -40.0
    scores = tuple(score(cost, "thermal-growth", constant=constant) for constant, cost in costs.items())
    assert others(0)[0] == []


@pytest.mark.parametrize("used", [True, False])
def test_they_are_read_as_they_were_written(final, used):
    """Fails if a model comes back with other effects, or its estimates in another order; also beside one that lacks the cause."""
    doubtful = judged(ratio(1.0), Rival(UNEXPLAINED, 0, 1.0, None))
    found = fitted_alternatives([doubtful], final) if used else fitted_alternatives([], final, [doubtful])
    model = final.model if used else replace(final.model, effects=final.plain)
    again = [_alternative(stated, model) for stated in alternative_models(found, model)]
    for one, other in zip(found, again, strict=True):
        assert other.model.effects == one.model.effects
        assert (other.gone, other.rival) == (one.gone, one.rival)
        assert other.estimate == pytest.approx(one.estimate)
        assert other.probability == pytest.approx(one.probability)


def test_they_are_read_by_name(final):
    """Fails if estimates are read by their place in the file: verdicts are in the order of gain, a model's causes in any."""
    found_first, found_last = cause("joint-backlash", "joint1"), cause("gear-ratio-error", "joint3")
    model = final.with_causes([found_first, ECCENTRIC, found_last])
    verdicts = [replace(judged(), cause=one) for one in (found_last, found_first)]
    (said,) = fitted_alternatives([*verdicts, judged(ratio(1.0))], model)
    (stated,) = alternative_models([said], model.model)
    read = _alternative(stated, model.model)
    rows = model.data.conditions
    assert read.model.point(read.estimate, rows) == pytest.approx(said.model.point(said.estimate, rows), abs=1e-12)


def test_a_prediction_is_wider_by_what_the_others_say(final):
    """Fails if the choice of the model does not reach a prediction's variance, or not by its probability."""
    conditions = final.data.conditions
    bare = replace(final.model, effects=final.plain)
    estimate = final.fit.estimate[: len(bare.parameters)]
    other = Alternative(bare, estimate, 0.25)
    apart = bare.point(estimate, conditions) - final.model.point(final.fit.estimate, conditions)
    assert np.abs(apart).max() > 1e-5
    known = final.model, final.fit.estimate, points_at(conditions)
    assert (choice_errors((other,), *known) ** 2).sum(axis=2) == pytest.approx(0.25 * apart**2)
    assert not choice_errors((), *known).size
