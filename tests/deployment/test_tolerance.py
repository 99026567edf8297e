"""Tolerance: a stated probability is how often it comes true."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.deployment.tolerance import Errors


def test_what_is_stated_with_nine_in_ten_is_right_in_nine_of_ten():
    """Fails if a further pose stays below its 90 % error more or less often than that, of few poses or of many."""
    rng = np.random.default_rng(5)
    for number in (5, 20):
        drawn = np.linalg.norm(rng.standard_normal((2000, number + 1, 3)), axis=2)
        stated = np.array([Errors.of(known).within(further) for *known, further in drawn])
        assert 0.87 < (stated < 0.9).mean() < 0.93


def test_all_of_the_task_is_less_probable_than_one_pose():
    """Fails if the task's probability is that of one pose, or that of independent poses with a scatter that is known."""
    known = Errors.of(np.linalg.norm(np.random.default_rng(1).standard_normal((8, 3)), axis=1))
    limit = known.reached_by(0.9)
    assert known.within(limit) == pytest.approx(0.9, abs=1e-9)
    assert known.within(known.reached_by(0.9, 8), 8) == pytest.approx(0.9, abs=1e-8)
    assert 0.9**8 + 0.05 < known.within(limit, 8) < 0.85
    assert known.within(limit, 1) > known.within(limit, 2) > known.within(limit, 20)


@pytest.mark.parametrize(("factor", "poses"), [(0.0, 12), (0.6, 40)])
def test_the_task_is_met_as_often_as_stated_where_errors_differ_from_place_to_place(factor, poses):
    """Fails if the largest of many further errors is taken for that of noise alone where places differ by factors."""
    rng = np.random.default_rng(8)
    places = np.exp(factor * rng.standard_normal((500, 2 * poses)))
    drawn = places * np.linalg.norm(rng.standard_normal((500, 2 * poses, 3)), axis=2)
    stated = np.array([Errors.of(row[:poses]).within(row[poses:].max(), poses) for row in drawn])
    assert 0.86 < (stated < 0.9).mean() < 0.955


def test_errors_that_are_nothing_or_all_alike_are_no_trouble():
    """Fails if a pose without any error, or poses with the same, make a probability that is no number."""
    assert 0.5 < Errors.of(np.array([0.0, 0.2, 0.3, 0.25, 0.1])).within(0.6) < 1
    assert Errors.of(np.zeros(5)).within(0.1) == 1
    alike = Errors.of(np.full(5, 0.2))
    assert (alike.within(0.3), alike.within(0.1)) == (1, 0)
    assert alike.reached_by(0.9) == pytest.approx(0.2)


def test_fewer_poses_and_lost_ones_make_it_less_sure():
    """Fails if what a fitted frame took counts as measured, or two poses are enough to state a probability."""
    error = np.array([1.0, 1.2, 0.8, 1.1, 0.9, 1.05])
    assert Errors.of(error, lost=2.0).reached_by(0.95) > Errors.of(error).reached_by(0.95)
    assert np.isnan(Errors.of(error[:2]).within(2.0))
    assert np.isnan(Errors.of(error, lost=4.0).within(2.0))
