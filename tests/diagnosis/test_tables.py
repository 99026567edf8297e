"""The table of findings says what the model leaves, whether anything explains it or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.diagnosis.diagnosis import Diagnosis
from calflow.diagnosis.findings import Finding, _kept_together, _together, findings
from calflow.diagnosis.misfit import largest_misfit
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.unexplained import POSE, UnexplainedStructure, is_of_its_curve, left_along
from calflow.diagnosis.verdict import Rival
from calflow.effects.wording import UNEXPLAINED, NamedCause
from calflow.files.problems import InputError
from calflow.files.tables import from_frame, to_frame
from calflow.model import build
from diagnosis.found import cause, hidden, start
from diagnosis.test_misfit import rng, rough
from diagnosis.test_unexplained import fitted
from diagnosis.test_verdict import judged, score
from estimation.data import calibration

FAULTS = pd.DataFrame({"cause": [], "joint": [], "line": [], "action": [], "statement": []})


@pytest.fixture(scope="module")
def uneven():
    """A model whose errors are large at one quarter of the first joint's travel, and follow nothing there."""
    return fitted(rough(lambda t: t["q1"] > np.quantile(t["q1"], 0.75)))


def diagnosis(last, **more):
    """A diagnosis that found no cause."""
    first = Linearisation.at(last, ()).screened(np.random.default_rng(1))
    return Diagnosis(last, first, last, last, (), (), None, Catalogue((), {}), 0.01, **more)


@pytest.mark.parametrize(("doubt", "least"), [(0.04, False), (0.06, True)])
def test_a_cause_that_may_be_something_unnamed_promises_no_more_than_the_model_without_it(doubt, least):
    """Fails if page one's limit, of 95 in 100, takes for certain what is not by more than the other five."""
    eccentric = cause("joint-eccentricity", "joint1", order=2)
    plain = start(hidden([(eccentric, (4e-4, -3e-4))], poses=30))
    extended = plain.with_causes([eccentric])
    unnamed = Rival(UNEXPLAINED, 0, -2 * np.log(doubt), None)
    named = replace(judged(score(-50.0, "joint-eccentricity", 1, order=2)), rivals=(unnamed,), probability=1.0)
    found = replace(diagnosis(extended), start=plain, verdicts=(named,))
    limits = [model.left_out.upper_limit(not least) for model in (plain, extended)]
    assert limits[0] > 2 * limits[1]
    assert found.upper_limit == pytest.approx(limits[0 if least else 1], rel=0.05)


def told(found):
    """The rows of findings.csv."""
    made = findings(
        found,
        calibration(found.start.model, found.start.fit.estimate, found.start.covariance),
        found.start.data,
        FAULTS,
        np.random.default_rng(1),
    )
    read = from_frame(to_frame(made, Finding), Finding)
    assert [one.statement for one in read] == [one.statement for one in made]
    return read


def test_a_lack_of_fit_has_a_row_though_no_input_explains_it(uneven):
    """Fails if a model that lacks something ends in an empty table, or its row does not say where."""
    (row,) = told(diagnosis(uneven, worst=largest_misfit(uneven, rng())))
    assert (row.status, row.cause, row.inputs) == ("unexplained", "", ())
    assert row.detail.startswith("joint 1 is between")
    assert row.p_family < 1e-6
    assert row.detail in row.statement
    assert "times the noise (chance of so much: less than one in a million)" in row.statement
    assert told(diagnosis(fitted())) == []


def member(number, cost, name, joint=2, **variant):
    """A finding, of joint 2 if not stated, as the table tells it alone, with its verdict."""
    verdict_ = judged(
        score(cost, name, joint, **variant), *([score(cost + 3, "joint-compliance", 2)] if number == 1 else [])
    )
    cause, alike = verdict_.cause, tuple(rival.id for rival in verdict_.rivals)
    row = Finding(status=verdict_.status, cause=cause.id, joint=joint or None, estimate=3e-4 * number, sd=1e-5, unit="rad",
                  p_family=1e-4 * number, probability=0.9, detail=cause.detail, statement="alone", cannot_tell_from=alike,
                  numbers=(number,))  # fmt: skip
    return row, verdict_


def test_an_order_that_is_only_suspected_is_told_with_the_one_in_use():
    """Fails if the finding is described by what is not in the model to be used, or does not say what is left out of it."""
    (first, one), (second, two) = (
        member(1, -50.0, "joint-eccentricity"),
        member(2, -90.0, "periodic-joint-error", order=5.0),
    )
    row = _together([replace(first, deployed=True), replace(second, deployed=False)], [one, two])
    assert (row.cause, row.deployed, row.numbers) == ("joint-eccentricity", True, (1, 2))
    assert row.statement.endswith("; suspected, and left out of the model: periodic error (order 5)")
    neither = _together([replace(first, deployed=False), replace(second, deployed=False)], [one, two])
    assert (neither.cause, neither.is_suspicion) == ("periodic-joint-error", True)


def test_several_orders_of_a_joint_are_one_finding_of_their_family():
    """Fails if each order is told as a cause of its own, or what one member cannot be told from is lost."""
    (first, one), (second, two) = (
        member(1, -50.0, "joint-eccentricity"),
        member(2, -90.0, "periodic-joint-error", order=5.0),
    )
    row = _together([first, second], [one, two])
    assert (row.status, row.cause, row.joint, row.numbers) == ("one_of", "periodic-joint-error", 2, (1, 2))
    assert {"joint-eccentricity", "joint-error-map", "joint-compliance"} <= set(row.cannot_tell_from)
    assert row.rivals == (NamedCause("joint-eccentricity", 2), NamedCause("joint-compliance", 2))
    assert (row.estimate, row.p_family) == (pytest.approx(3e-4 * np.sqrt(5)), 1e-4)
    assert row.statement.startswith("transmission error of joint 2: periodic error (order 5), and ")
    assert row.detail.startswith("order 5, with eccentricity")
    assert _together([first, second, second], [one, two, two]).detail == "order 5, with 2 more"
    other = one.cause, two.cause, replace(one.cause, part="joint3")
    assert _kept_together(other) == [[0, 1], [2]]
    assert _kept_together([other[2], *other[:2]]) == [[0], [1, 2]]


@pytest.mark.parametrize(("name", "other", "joint", "family"), [
    ("nonlinear-joint-stiffness", "torque-backlash", 2, "nonlinear compliance of joint 2"),
    ("gear-ratio-error", "joint-eccentricity", 2, "transmission error of joint 2"),
    ("tool-deflection", "tool-sag", 0, "compliance of the tool"),
])  # fmt: skip
def test_two_forms_of_one_thing_are_one_finding(name, other, joint, family):
    """Fails if two names are told as certain of what may be one thing in a third form, or one of them is lost."""
    (first, one), (second, two) = member(2, -90.0, name, joint), member(3, -50.0, other, joint)
    assert _kept_together([one.cause, two.cause]) == [[0, 1]]
    row = _together([first, second], [one, two])
    assert (row.status, row.of_family, row.name, row.kin[0]) == ("one_of", True, family, other)
    assert two.cause.title in row.detail


def test_sizes_that_measure_two_things_are_not_put_together():
    """Fails if a curve's root mean square and an amplitude at the rated torque are told as one size."""
    (first, one), (second, two) = member(1, -50.0, "joint-eccentricity"), member(2, -90.0, "loaded-transmission-error")
    assert _together([first, second], [one, two]).estimate == pytest.approx(6e-4)


def test_rivals_without_their_joints_are_refused():
    """Fails if a table from which a joint was taken is read with one rival less, or ends in a traceback."""
    told = Finding.of_rivals([NamedCause("joint-backlash", 2), NamedCause("gear-ratio-error", 3)])
    table = to_frame([Finding(status="named", cause="joint-hysteresis", statement="", **told)], Finding)
    assert from_frame(table, Finding)[0].rivals[1].joint == 3
    table["rival_joints"] = ["2"]
    with pytest.raises(InputError, match="rival_causes and rival_joints are not equally long"):
        from_frame(table, Finding)


def test_an_error_of_two_joints_is_no_other_form_of_one_joints_curve():
    """Fails if a gear is certain, its order alone open, while an error of its angle and another's (a hose's, say) has no name."""
    acting = cause("joint-eccentricity", "joint2", order=1)
    left = UnexplainedStructure(("q2", "q5"), 1e-9, 0.5, ())
    assert not is_of_its_curve(left, acting)
    assert is_of_its_curve(replace(left, along=("q2",)), acting)
    assert is_of_its_curve(replace(left, inputs=(POSE, "q2")), acting)  # waves too short for these poses


@pytest.mark.parametrize(("name", "part", "inputs", "doubted"), [
    ("bearing-compliance", "joint1", ("payload",), True),
    ("bearing-compliance", "joint1", ("q4",), False),
    ("thermal-growth", "links", ("order",), True),
    ("thermal-growth", "links", ("payload",), False),
    ("joint-eccentricity", "joint2", ("q2", "q5"), True),
    ("joint-eccentricity", "joint2", ("time",), False),
    ("frame-drift", "device", ("time",), True),
])  # fmt: skip
def test_a_cause_is_doubted_where_more_is_left_along_an_input_through_which_it_acts(name, part, inputs, doubted):
    """Fails if a soft bearing is certain while what a payload does is not explained, or a growth while time leaves more."""
    acting = cause(name, part, **({"constant": 3600.0} if name == "thermal-growth" else {}))
    model = replace(build(acting.robot, ("geometry",)), given=("time", "order"))
    structure = UnexplainedStructure(inputs, 1e-9, 0.5, ())
    assert left_along(acting, model, (structure,)) == (structure if doubted else None)
    assert left_along(acting, model, ()) is None
