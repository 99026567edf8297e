"""Optimality: the indices are those of the literature, and the tool's error is the mean of its points'."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.design.optimality import ParameterCriterion, ToolError, indices


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


def test_losses_are_standard_deviations():
    """Fails if a loss is a variance, or the tool's points do not count as much as their shares say."""
    covariance = np.diag([4.0, 9.0])
    assert ParameterCriterion(2).loss(covariance) == pytest.approx(np.sqrt(6))
    slopes = np.zeros((2, 3, 2))
    slopes[0, 0, 0] = slopes[1, 2, 1] = 1
    tool = ToolError(slopes, np.array([0.75, 0.25]))
    assert tool.variances(covariance) == pytest.approx([4, 9])
    assert tool.loss(covariance) == pytest.approx(np.sqrt(0.75 * 4 + 0.25 * 9))
