"""How many poses: the number that is said to be enough is, and fewer than are said to be needed are not."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calflow.design.optimality import ToolError, information
from calflow.design.worth import knee, next_best, poses_for_tolerance

PRIOR = np.eye(4)


@pytest.fixture
def case():
    """Ten candidates and a task of eight points."""
    rng = np.random.default_rng(3)
    return 2 * rng.standard_normal((10, 3, 4)), ToolError(rng.standard_normal((8, 3, 4)), np.full(8, 1 / 8))


def loss(jacobians, tool, chosen):
    """The tool's error with these poses."""
    return tool.loss(np.linalg.inv(PRIOR + sum(jacobians[k].T @ jacobians[k] for k in chosen)))


def test_enough_is_enough_and_fewer_than_needed_are_not(case):
    """Fails if of all choices one of fewer poses than are needed meets the tolerance, or none of as many as are enough."""
    jacobians, tool = case
    best = {n: min(loss(jacobians, tool, each) for each in combinations(range(10), n)) for n in range(1, 8)}
    for asked in (2, 4, 6):
        number, needed = poses_for_tolerance(jacobians, PRIOR, tool, 1.0001 * best[asked], np.random.default_rng(1))
        assert number == asked
        assert needed <= asked
        assert all(best[n] > 1.0001 * best[asked] for n in range(1, needed))


def test_what_cannot_be_met_or_is_met_already(case):
    """Fails if a tolerance beyond all candidates is promised, or poses are asked for where none are needed."""
    jacobians, tool = case
    everything = loss(jacobians, tool, range(10))
    rng = np.random.default_rng(1)
    assert poses_for_tolerance(jacobians, PRIOR, tool, 0.99 * everything, rng) == (None, None)
    assert poses_for_tolerance(jacobians, PRIOR, tool, 1.01 * tool.loss(PRIOR), rng) == (0, 0)


def test_the_next_ten_are_the_best_that_are_left(case):
    """Fails if the poses chosen count twice, or the one that gains most does not come first."""
    jacobians, tool = case
    added = next_best(jacobians, information(jacobians[[4, 7]], PRIOR), [4, 7], tool)
    assert sorted([4, 7, *added]) == list(range(10))
    firsts = [loss(jacobians, tool, [4, 7, k]) for k in added]
    assert firsts[0] == min(firsts)


def test_the_knee_is_where_the_curve_bends():
    """Fails if the knee is not the corner of a curve that has one."""
    numbers = np.arange(10, 61, 5)
    errors = np.where(numbers < 25, 100 - 4 * numbers, 2 - 0.02 * numbers)
    assert knee(numbers, errors) == 25
