"""Rewriting: numbers keep their way of being written, orientations come as near as can be to what stood there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.deployment.conventions import pose_matrix, pose_values
from calflow.programs.edits import PLACE_STEP, TURN_STEP, spelled
from calflow.programs.target import Number

MM, DEG = 1e-3, np.pi / 180


@pytest.mark.parametrize(
    ("text", "scale", "value", "step", "expected"),
    [
        ("600", MM, 0.6001234, PLACE_STEP, "600.123"),
        ("600.5", MM, 0.6005, PLACE_STEP, "600.5"),
        ("600.12345", MM, 0.6001237, PLACE_STEP, "600.12370"),
        ("6e2", MM, 0.6001234, PLACE_STEP, "600.123"),
        ("6E+02", MM, 0.6, PLACE_STEP, "6E+02"),
        ("+0.3", 1.0, 0.3000126, PLACE_STEP, "+0.300013"),
        ("+0.3", 1.0, -0.3, PLACE_STEP, "-0.300000"),
        (".433025361705", 1.0, 0.5, PLACE_STEP, ".500000000000"),
        ("-.25", MM, -0.000123456, PLACE_STEP, "-.123"),
        ("0.001", MM, -1e-10, PLACE_STEP, "0.000"),
        ("-175.187", DEG, -175.1871 * DEG, TURN_STEP, "-175.18710"),
        ("1", 1.0, 0.99999996, TURN_STEP, "1"),
    ],
)
def test_a_number_is_written_as_it_was(text, scale, value, step, expected):
    """Fails if decimals are lost, a number that stays is written anew, or a sign or a missing 0 changes its way."""
    assert spelled(Number(0, len(text), text, scale), value, step) == expected


RIGHT_ANGLE = np.pi / 2


@pytest.mark.parametrize("turn", ["quaternion", "zyx", "xyz", "vector"])
def test_orientations_lead_there_and_back(turn):
    """Fails if the figures of an orientation mean another one, or are others than those that it was read from."""
    rng = np.random.default_rng(1)
    for k in range(200):
        if turn == "quaternion":
            figures = rng.standard_normal(4)
            figures /= np.linalg.norm(figures)
        elif turn == "vector":
            figures = rng.standard_normal(3) * (0.0 if k == 0 else 3.0)
        else:
            figures = rng.uniform(-np.pi, np.pi, 3)
            figures[1] = (RIGHT_ANGLE, -RIGHT_ANGLE, figures[1] / 2, figures[1])[k % 4]
        values = np.concatenate([rng.uniform(-1, 1, 3), figures])
        pose = pose_matrix(values, turn)
        np.testing.assert_allclose(pose_values(pose, turn, values), values, atol=1e-7)
        pose[:3, :3] = Rotation.from_rotvec(1e-3 * rng.standard_normal(3)).as_matrix() @ pose[:3, :3]
        again = pose_matrix(pose_values(pose, turn, values), turn)
        np.testing.assert_allclose(again, pose, atol=1e-9)


def test_what_the_makers_mean_by_their_angles():
    """Fails if KUKA's angles are not about z, y', x'', FANUC's not about the fixed x, y, z, or ABB's scalar is not first."""
    a, b, c = 0.3, -0.5, 1.1
    x, y, z = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in (("x", c), ("y", b), ("z", a)))
    expected = z @ y @ x
    np.testing.assert_allclose(pose_matrix([0, 0, 0, a, b, c], "zyx")[:3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(pose_matrix([0, 0, 0, c, b, a], "xyz")[:3, :3], expected, atol=1e-12)
    half = np.sqrt(0.5)
    turned = pose_matrix([0, 0, 0, half, 0, 0, half], "quaternion")[:3, :3]
    np.testing.assert_allclose(turned @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    turned = pose_matrix([0, 0, 0, 0, 0, np.pi / 2], "vector")[:3, :3]
    np.testing.assert_allclose(turned @ [1, 0, 0], [0, 1, 0], atol=1e-12)
