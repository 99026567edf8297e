"""ISO 9283: repeatability as it is worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.deployment.attained import angle_repeatability, cube_edge, pose_repeatability

# Four attained positions about (1000.3, 0.4, 500), their barycentre: they lie 0.1, 0.1, 0.3 and 0.3 from it, so that the mean is
# 0.2 and S = sqrt(4 · 0.01 / 3) = 0.115470, and RP = 0.2 + 0.346410.
ATTAINED = np.array([[1000.4, 0.4, 500.0], [1000.2, 0.4, 500.0], [1000.3, 0.7, 500.0], [1000.3, 0.1, 500.0]])


def test_repeatability_is_that_worked_out_by_hand():
    """Fails if RP is not mean + 3 S, or S is not that of n - 1 degrees of freedom."""
    assert pose_repeatability(ATTAINED) == pytest.approx(0.5464101615, abs=1e-9)


def test_a_second_example_off_the_plane():
    """Fails if one axis counts for more than another: (0, 0, 0), (2, 2, 1), (4, 4, 2) lie 3, 0 and 3 from their middle."""
    attained = np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 1.0], [4.0, 4.0, 2.0]])
    assert pose_repeatability(attained) == pytest.approx(2.0 + 3 * np.sqrt(3.0))


def test_angles_scatter_by_three_standard_deviations():
    """Fails if RP of an orientation is not 3 S of each angle."""
    angles = np.array([[0.0, 1.0, 0.0], [0.0, 3.0, 0.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(angle_repeatability(angles), [0.0, 3.0, 0.0], atol=1e-12)


def test_a_single_pose_has_no_repeatability():
    """Fails if what was measured once looks perfectly repeatable."""
    assert np.isnan(pose_repeatability(ATTAINED[:1]))
    assert np.isnan(angle_repeatability(ATTAINED[:1])).all()


def test_the_cube_is_known_by_its_five_poses():
    """Fails if the standard's poses are not placed, or not recognised however the cube stands and in whatever order."""
    corners = 0.5 * np.array([(1, 1, 1), (1, -1, 1), (-1, -1, -1), (-1, 1, -1)])
    points = np.array([1.8, 0.0, 1.0]) + np.vstack(
        [np.zeros(3), 0.8 * corners]
    )  # a tenth of each diagonal from its ends
    assert np.linalg.norm(points[1] - points[3]) == pytest.approx(0.8 * np.sqrt(3))
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    assert cube_edge((points @ turn)[[3, 0, 4, 1, 2]]) == pytest.approx(1.0)
    points[2] += 0.1
    assert np.isnan(cube_edge(points))
    assert np.isnan(cube_edge(points[:4]))
