"""Pose selection: the greedy and exchanged choice is what it claims, and the indices are those of the literature."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calflow.design.optimality import exchange, greedy, indices, log_determinant


@pytest.fixture
def jacobians():
    return np.random.default_rng(12).standard_normal((9, 3, 4))


def test_greedy_takes_the_best_candidate_each_time(jacobians):
    """Fails if the rank-3 update of the covariance is wrong."""
    prior = np.eye(4)
    chosen: list[int] = []
    for _ in range(5):
        rest = [c for c in range(9) if c not in chosen]
        chosen.append(max(rest, key=lambda c: log_determinant(jacobians[[*chosen, c]], prior)))
    assert greedy(jacobians, prior, 5) == chosen


def test_exchange_reaches_what_no_swap_improves(jacobians):
    """Fails if exchange stops early or accepts a worse swap."""
    prior = np.eye(4)
    start = [0, 1, 2]
    found = exchange(jacobians, prior, start)
    value = log_determinant(jacobians[found], prior)
    assert value >= log_determinant(jacobians[start], prior)
    for k in range(3):
        for c in set(range(9)) - set(found):
            swapped = [*found[:k], c, *found[k + 1 :]]
            assert log_determinant(jacobians[swapped], prior) <= value + 1e-6
    best = max(log_determinant(jacobians[list(s)], prior) for s in combinations(range(9), 3))
    assert value > best - 0.2


def test_indices_follow_their_definitions():
    """Fails if an index is mistaken for another; singular values are 4, 2 and 1 by construction, of two poses."""
    jacobian = np.zeros((6, 3))
    jacobian[[0, 1, 2], [0, 1, 2]] = 4, 2, 1
    o1, o2, o3, o4, o5 = indices(jacobian, 3)
    assert o1 == pytest.approx(2 / np.sqrt(2))
    assert (o2, o3, o4) == pytest.approx((0.25, 1, 0.25))
    assert o5 == pytest.approx(1 / (0.25 + 0.5 + 1))


def test_too_few_poses_observe_nothing():
    """Fails if an index is given where a parameter is not seen at all."""
    assert (indices(np.eye(3)[:2], 3) == 0).all()
