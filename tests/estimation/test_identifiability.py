"""What the data determine is counted and said in words."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.fit import fit
from calflow.estimation.identifiability import _directions, best_subset, left_open, rank_by_effect
from calflow.model import build
from estimation.data import drawn_truth, measured, problem
from robots import hh800


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(6)
    model = build(hh800(), ("geometry", "joint-compliance"))
    return fit(problem(model, measured(model, drawn_truth(model, rng), 100, rng)))[0]


def test_the_full_set_of_the_hh800_has_rank_29_and_5(fitted):
    """Fails if a redundant direction counts as known, or a known one as redundant."""
    assert rank_by_effect(fitted) == {"geometry": 29, "joint-compliance": 5}
    assert len(fitted.model.parameters) == 37


def test_the_three_unidentifiable_directions_are_named(fitted):
    """Fails if a direction is not told, or with parameters that have no part in it."""
    words = left_open(fitted)
    told = words[words["kind"].isin(["silent", "trade"])]
    directions = [set(parameters.split(";")) for parameters in told["parameters"]]
    assert len(directions) == 3
    assert {"joint1.s"} in directions
    assert {"joint6.d", "E.z"} in directions
    (twist,) = (d for d in directions if "joint6.theta" in d)
    assert twist <= {"joint6.theta", "E.x", "E.y"}
    assert len(twist) > 1


def test_a_smaller_count_keeps_what_the_data_know(fitted):
    """Fails if the paper's count of 25 + 4 keeps a redundant pair or drops one of its own compliances."""
    kept = best_subset(fitted, {"geometry": 25, "joint-compliance": 4})
    by_effect = kept[kept["kept"]].groupby("effect")["parameter"].apply(set)
    assert len(by_effect["geometry"]) == 25
    assert by_effect["joint-compliance"] == {f"joint{i}.s" for i in (2, 3, 4, 5)}
    assert not {"joint6.d", "E.z"} <= by_effect["geometry"]


def test_a_joint_that_never_moves_is_told():
    """Fails if a direction that these data cannot see is taken for known."""
    rng = np.random.default_rng(7)
    model = build(hh800(), ("geometry",))
    truth = drawn_truth(model, rng)
    data = measured(model, truth, 60, rng)
    data.table["q5"] = 0.5
    data.table[["x", "y", "z"]] = model.position(truth, data.conditions)
    found = fit(problem(model, data))[0]
    assert rank_by_effect(found)["geometry"] < 29
    assert left_open(found)["parameters"].str.contains("joint5").any()


@pytest.mark.parametrize(("unsure", "named"), [(0.011, ("zero", "place")), (0.05, ("zero",))])
def test_a_place_that_makes_up_for_a_zero_by_little_of_its_prior_is_named_with_it(unsure, named):
    """Fails if a zero seems merely unseen while a camera's place follows it, or a place is named that hardly does."""
    direction = np.array([[1.0, 0.012]])
    device = np.array([False, True])
    (row,) = _directions(direction, ["zero", "place"], np.array([0.9, unsure]), device, null=False)
    assert row.parameters == named
