"""The search: chosen poses are the best of all, and the bound on others holds and is near."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calflow.design.optimality import ParameterCriterion, ToolError, information
from calflow.design.search import exchange, greedy, relaxed, search_poses, search_worst

N, CANDIDATES, CHOSEN = 5, 12, 4
PRIOR = np.diag([1.0, 2.0, 0.5, 1.0, 3.0])


def case(seed, candidates=CANDIDATES):
    """Jacobians of candidates, and a task of 20 points."""
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((20, 3, N)) * [1, 1, 0.2, 3, 0.01]
    return 3 * rng.standard_normal((candidates, 3, N)), ToolError(slopes, np.full(20, 1 / 20))


def criteria(tool):
    """Both kinds of criterion."""
    return (ParameterCriterion(N), tool)


def covariance(jacobians, chosen):
    """The covariance that poses leave, without a word of the code that is tested."""
    return np.linalg.inv(PRIOR + sum(jacobians[k].T @ jacobians[k] for k in chosen))


@pytest.mark.parametrize("k", [0, 1])
def test_greedy_takes_the_best_candidate_each_time(k):
    """Fails if the rank-3 update of the covariance is wrong, or a gain is not what the loss falls by."""
    jacobians, tool = case(12)
    criterion = criteria(tool)[k]
    chosen: list[int] = []
    for _ in range(5):
        rest = [c for c in range(CANDIDATES) if c not in chosen]
        chosen.append(min(rest, key=lambda c: criterion.loss(covariance(jacobians, [*chosen, c]))))
    assert greedy(jacobians, PRIOR, 5, criterion) == chosen


@pytest.mark.parametrize("k", [0, 1])
def test_exchange_reaches_what_no_swap_improves(k):
    """Fails if exchange stops early or accepts a worse swap."""
    jacobians, tool = case(13)
    criterion = criteria(tool)[k]
    found = exchange(jacobians, PRIOR, [0, 1, 2], criterion)
    loss = criterion.loss(covariance(jacobians, found))
    assert loss <= criterion.loss(covariance(jacobians, [0, 1, 2]))
    for i in range(3):
        for c in set(range(CANDIDATES)) - set(found):
            swapped = [*found[:i], c, *found[i + 1 :]]
            assert criterion.loss(covariance(jacobians, swapped)) >= loss * (1 - 1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_the_choice_is_that_of_an_exhaustive_search(seed):
    """Fails if any of the 495 choices is better than the one found, or than the bound says any can be."""
    jacobians, tool = case(seed)
    for criterion in criteria(tool):
        losses = [criterion.loss(covariance(jacobians, each)) for each in combinations(range(CANDIDATES), CHOSEN)]
        found = search_poses(jacobians, PRIOR, CHOSEN, criterion, np.random.default_rng(seed))
        assert found.loss == pytest.approx(min(losses), rel=1e-9)
        assert found.loss == pytest.approx(criterion.loss(covariance(jacobians, found.chosen)), rel=1e-9)
        assert len(set(found.chosen)) == CHOSEN
        assert found.bound <= min(losses) * (1 + 1e-9)
        assert found.bound > 0.8 * min(losses)


@pytest.mark.parametrize("seed", range(4))
def test_no_choice_is_better_in_the_worst_case_than_the_bound(seed):
    """Fails if the bound on the worst point is beyond what some choice reaches, or the choice is far from the best."""
    jacobians, tool = case(seed)
    worst = {
        each: np.sqrt(tool.variances(covariance(jacobians, each)).max())
        for each in combinations(range(CANDIDATES), CHOSEN)
    }
    found = search_worst(jacobians, PRIOR, CHOSEN, tool, np.random.default_rng(seed))
    assert found.bound <= min(worst.values()) * (1 + 1e-9)
    assert found.loss == pytest.approx(worst[tuple(sorted(found.chosen))], rel=1e-9)
    assert found.loss < 1.1 * min(worst.values())


def test_the_relaxed_design_cannot_be_bettered():
    """Fails if weights leave 0 … 1, do not add up, or another design's loss is below the bound; and if the gap is not closed."""
    jacobians, tool = case(3, 700)
    rng = np.random.default_rng(4)
    for criterion in criteria(tool):
        *_, design = relaxed(jacobians, PRIOR, 9, criterion)
        assert design.weights.sum() == pytest.approx(9)
        assert design.weights.min() >= 0
        assert design.weights.max() <= 1 + 1e-12
        loss = criterion.loss(np.linalg.inv(information(jacobians, PRIOR, design.weights)))
        assert design.bound <= loss < 1.001 * design.bound
        for _ in range(20):
            mixed = 0.9 * design.weights + 0.1 * 9 * rng.dirichlet(np.ones(700))
            other = criterion.loss(np.linalg.inv(information(jacobians, PRIOR, mixed)))
            assert other >= design.bound


def test_a_point_that_counts_more_is_surer():
    """Fails if the shares of the task's points do not reach the choice."""
    jacobians, tool = case(5, 60)
    one = replace(tool, shares=np.eye(20)[7])
    chosen, other = (search_poses(jacobians, PRIOR, 6, each, np.random.default_rng(1)).chosen for each in (one, tool))
    variance = [tool.variances(covariance(jacobians, each))[7] for each in (chosen, other)]
    assert variance[0] < 0.95 * variance[1]
