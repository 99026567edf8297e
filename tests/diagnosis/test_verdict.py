"""Verdicts: variants are weighed as evidence, and a name is given as surely as the rivals allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.findings import _detail
from calflow.diagnosis.regressors import Candidate
from calflow.diagnosis.screening import Family, Score, by_place
from calflow.diagnosis.stepwise import WITHIN
from calflow.diagnosis.trial import Detection
from calflow.diagnosis.verdict import verdict
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from robots import industrial

ROBOT = industrial()


def score(cost, name, joint=0, **variant):
    """A cause's score by its cost against the model without it."""
    effect = catalogue()[name](ROBOT, **variant)
    part = f"joint{joint}" if joint else effect.declared[0].part
    cause = Cause(ROBOT, effect, part)
    n = len(cause.declared)
    return Score(
        Candidate(cause, np.arange(n)), -cost, 0.1, 1e-9, cost, 1.0, np.zeros(n), np.eye(n), np.eye(n), n, 200.0
    )


def judged(*scores):
    """The verdict on the first score's cause, the others tested in its place."""
    ordered = sorted(scores, key=lambda s: s.cost)
    return verdict(Detection(scores[0].cause, tuple(ordered), Family({}, 1.0)))


def names(found):
    """The rivals' names."""
    return [(rival.id, rival.joint) for rival in found.rivals]


def test_variants_are_averaged_as_evidence():
    """Fails if a place is as good as its best variant, however many were tried, or as the mean of their costs."""
    raw = np.array([-40.0, -38.0, -10.0])
    paid = raw + 2 * np.log(len(raw))  # a score pays for its place's scan
    scores = [
        score(cost, "periodic-joint-error", 2, order=order) for cost, order in zip(paid, (3.0, 4.0, 5.0), strict=True)
    ]
    alone = score(-20.0, "gear-ratio-error", 2)
    places = by_place([*scores, alone])
    assert list(places) == [("periodic-joint-error", "joint2"), ("gear-ratio-error", "joint2")]
    cost, best = places["periodic-joint-error", "joint2"]
    assert cost == pytest.approx(-2 * np.log(np.mean(np.exp(-raw / 2))))
    assert best is scores[0]
    assert places["gear-ratio-error", "joint2"] == (pytest.approx(-20.0), alone)


def test_equal_variants_are_no_better_than_one():
    """Fails if a place gains by being scanned more finely."""
    once = by_place([score(-30.0, "periodic-joint-error", 2, order=3.0)])
    often = by_place(
        [score(-30.0 + 2 * np.log(7), "periodic-joint-error", 2, order=order) for order in np.linspace(3, 4, 7)]
    )
    place = "periodic-joint-error", "joint2"
    assert often[place][0] == pytest.approx(once[place][0])


def test_huge_evidence_does_not_overflow():
    """Fails if exponentials are taken of costs themselves."""
    found = judged(score(-9e5, "gear-ratio-error", 2), score(-8e5, "joint-compliance", 3))
    assert (found.status, found.probability) == ("named", 1.0)


@pytest.mark.parametrize(("apart", "status"), [(WITHIN - 0.1, "one_of"), (WITHIN + 0.1, "named"), (-5.0, "one_of")])
def test_a_name_is_given_where_no_rival_is_near(apart, status):
    """Fails if a rival within a cost of 10 is passed over, or one beyond it is held against the name."""
    assert WITHIN == 10
    found = judged(score(-50.0, "gear-ratio-error", 2), score(-50.0 + apart, "joint-compliance", 2))
    assert found.status == status
    assert names(found) == ([("joint-compliance", 2)] if status == "one_of" else [])
    assert [rival.cost for rival in found.rivals] == pytest.approx([apart] if status == "one_of" else [])
    assert found.probability == pytest.approx(1 / (1 + np.exp(-apart / 2)))


def test_all_places_share_the_probability_and_near_ones_are_ordered():
    """Fails if rivals beyond the limit have no weight, the cause rivals itself, or the nearest is not first."""
    found = judged(
        score(-50.0, "periodic-joint-error", 2, order=3.0),
        score(-49.0, "periodic-joint-error", 2, order=4.0),
        score(-42.0, "gear-ratio-error", 2),
        score(-46.0, "periodic-joint-error", 3, order=3.0),
        score(-30.0, "base-compliance"),
    )
    own = -50 - 2 * np.log(1 + np.exp(-0.5))
    assert names(found) == [("periodic-joint-error", 3), ("gear-ratio-error", 2)]
    assert [rival.cost for rival in found.rivals] == pytest.approx([-46 - own, -42 - own])
    weights = np.exp(-(np.array([-42.0, -46.0, -30.0]) - own) / 2)
    assert found.probability == pytest.approx(1 / (1 + weights.sum()))


def test_what_was_not_tested_but_looks_alike_has_an_equal_share():
    """Fails if backlash is named though hysteresis without a record of travel would look the same."""
    found = judged(score(-50.0, "joint-backlash", 3), score(-10.0, "gear-ratio-error", 3))
    assert found.status == "one_of"
    assert names(found) == [("joint-hysteresis", 3)]
    assert (found.rivals[0].cost, found.rivals[0].score) == (0.0, None)
    assert found.probability == pytest.approx(0.5)
    assert not found.among_kin


def test_what_was_tested_there_is_judged_by_its_score():
    """Fails if an alike cause counts as untested though it was tested at that joint; another joint's test is none."""
    here = judged(score(-50.0, "joint-backlash", 3), score(-20.0, "joint-hysteresis", 3))
    assert (here.status, here.rivals) == ("named", ())
    elsewhere = judged(score(-50.0, "joint-backlash", 3), score(-20.0, "joint-hysteresis", 2))
    assert names(elsewhere) == [("joint-hysteresis", 3)]


def test_what_the_data_could_not_test_is_not_excluded():
    """Fails if a drift without a clock is named for certain though the robot may have warmed up, or the reason is lost."""
    drift = score(-50.0, "frame-drift")
    lone = Detection(drift.cause, (drift,), Family({}, 1.0))
    found = verdict(lone, {"thermal-growth": "a column time_s"})
    assert (found.status, found.probability) == ("one_of", pytest.approx(0.5))
    assert [(rival.id, rival.needs, rival.score) for rival in found.rivals] == [
        ("thermal-growth", "a column time_s", None)
    ]
    assert verdict(lone).status == "named"


TRANSMISSION = "transmission error"


@pytest.mark.parametrize(
    ("rivals", "family"),
    [
        ([("joint-eccentricity", 2)], TRANSMISSION),
        ([("joint-eccentricity", 2), ("gear-transmission-error", 2)], TRANSMISSION),
        ([("joint-eccentricity", 3)], ""),
        ([("periodic-joint-error", 3)], ""),
        ([("gear-ratio-error", 2)], TRANSMISSION),
        ([("joint-compliance", 2)], ""),
        ([("joint-eccentricity", 2), ("joint-compliance", 2)], ""),
        ([], ""),
    ],
)
def test_a_family_is_named_where_all_rivals_are_of_it(rivals, family):
    """Fails if rivals of another family or joint are hidden behind a family's name, or a lone name is made vague."""
    geared = replace(ROBOT, joints=tuple(replace(j, gear_ratio=200.0) for j in ROBOT.joints))
    effects = {name: catalogue()[name](geared) for name, _ in rivals}
    others = []
    for name, joint in rivals:
        own = score(-47.0, "gear-ratio-error", joint)
        cause = Cause(geared, effects[name], f"joint{joint}")
        others.append(
            Score(
                Candidate(cause, np.arange(2)),
                47.0,
                0.1,
                1e-9,
                own.cost,
                1.0,
                np.zeros(2),
                np.eye(2),
                np.eye(2),
                2,
                200.0,
            )
        )
    found = judged(score(-50.0, "periodic-joint-error", 2, order=3.0), *others)
    assert names(found) == rivals
    assert found.among_kin == bool(family)


def test_a_cause_without_a_family_is_named_by_itself():
    """Fails if two causes that belong to no family are called by its empty name."""
    found = judged(score(-50.0, "gravity-deflection", 2), score(-47.0, "joint-compliance", 2))
    assert found.status == "one_of"
    assert not found.among_kin


@pytest.mark.parametrize(("unnamed", "status"), [(2 * WITHIN + 1, "named"), (2 * WITHIN - 1, "one_of")])
def test_what_nobody_can_name_is_a_rival_whose_form_is_a_guess(unnamed, status):
    """Fails if evidence against a background counts in full though nobody knows the background's form."""
    only = score(-50.0, "gear-ratio-error", 2)
    found = verdict(Detection(only.cause, (only,), Family({}, 1.0), unnamed=unnamed))
    assert found.status == status
    assert found.probability >= 1 / (1 + np.exp(-unnamed / 4)) - 1e-9


def test_the_same_effect_at_another_part_is_no_rival():
    """Fails if a reader is to tell sag of the tool from sag of the tool: a tool and a marker's mount may sag side by side."""
    own, beside, other = (
        score(cost, name) for cost, name in ((-40.0, "tool-sag"), (-39.0, "tool-sag"), (-38.0, "frame-drift"))
    )
    several = replace(ROBOT, markers=dict(ROBOT.markers) | {"A": replace(ROBOT.markers["E"], point=(0.0, 0.1, 0.2))})
    of_a_mount = Cause(several, catalogue()["tool-sag"](several), "A")
    beside = replace(beside, candidate=replace(beside.candidate, cause=of_a_mount))
    found = judged(own, beside, other)
    assert sorted(names(found)) == [("frame-drift", 0), ("tool-sag", 0)]
    assert [rival.id for rival in found.others] == ["frame-drift"]
    assert _detail(found).endswith(" or A")
