"""The usual closed forms of hand-eye calibration: poses made in plain numpy, whose camera is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.observations.hand_eye_methods import METHODS, camera_by
from observations.photographed import IN_HAND, ON_TABLE, frame


def sightings(n: int, noise: float, turn: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Poses of a hand (n, 4, 4), and of the target as a camera in it sees it, off by noise [m and rad]."""
    rng = np.random.default_rng(1)
    hand = np.array([frame(Rotation.from_rotvec(turn * v[:3]), 0.4 * v[3:]) for v in rng.normal(size=(n, 6))])
    off = np.array([frame(Rotation.from_rotvec(v[:3]), v[3:]) for v in noise * rng.normal(size=(n, 6))])
    return hand, np.linalg.inv(hand @ IN_HAND) @ ON_TABLE @ off


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_is_where_each_method_has_it(method):
    """Fails if a method's equations are wrong, or noise of 1 mm and 1 mrad throws it off by more than a few of them."""
    np.testing.assert_allclose(camera_by(method, *sightings(12, 0.0)), IN_HAND, atol=1e-9)
    np.testing.assert_allclose(camera_by(method, *sightings(12, 1e-3)), IN_HAND, atol=3e-3)


@pytest.mark.parametrize("method", METHODS)
def test_pairs_that_turn_by_half_a_turn_do_not_throw_it_off(method):
    """Fails if rotations whose axis may point either way count: noise then turns a camera by tens of milliradians."""
    hand, seen = sightings(12, 5e-4)
    half = Rotation.from_rotvec(np.pi * np.array([0.6, 0.0, 0.8])).as_matrix()
    hand[1, :3, :3] = hand[0, :3, :3] @ half
    seen[1] = np.linalg.inv(hand[1] @ IN_HAND) @ ON_TABLE @ frame(Rotation.from_rotvec((5e-4, -5e-4, 5e-4)))
    np.testing.assert_allclose(camera_by(method, hand, seen), IN_HAND, atol=3e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_hand_that_never_turns_tells_no_camera(method):
    """Fails if a method gives figures where nothing turns, or ends in a traceback."""
    with pytest.raises(ValueError, match="no two pairs of images that are turned"):
        camera_by(method, *sightings(8, 0.0, turn=0.0))
