"""Pose: coordinates and an orientation in the frame of a station."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.measurements.series import Series, Station
from calflow.observations.pose import Pose
from observations.graph import error, frame, through_json, turned


def table(points: np.ndarray, rotations: np.ndarray) -> pd.DataFrame:
    """What a device reports."""
    angles = Rotation.from_matrix(rotations).as_euler("XYZ")
    return pd.DataFrame(np.hstack([points, angles]), columns=["x", "y", "z", "rx", "ry", "rz"])


def test_an_orientation_errs_by_the_turn_from_measured_to_predicted():
    """Fails if axes, sign or size of the turn are wrong, in a station of its own too."""
    rng = np.random.default_rng(1)
    points, reported = rng.normal(size=(2, 7, 3))
    predicted, place = turned(rng, 7), 0.3 * rng.normal(size=6)
    turn, origin = frame(place)
    small = 0.2 * rng.normal(size=(7, 3))
    in_station = turn.T @ predicted
    measured = in_station @ Rotation.from_rotvec(-small).as_matrix()
    rows = table(reported, measured)
    one = Pose.beside(Series(station=Station("B")), rows, first=False)
    found = error(one, place, points, rows, predicted)
    angle = np.linalg.norm(small, axis=1, keepdims=True)
    np.testing.assert_allclose(found[:, :3], (points - origin) @ turn - reported, atol=1e-12)
    np.testing.assert_allclose(found[:, 3:], 2 * np.sin(angle / 2) * small / angle, atol=1e-12)


def test_what_is_expected_leaves_no_error():
    """Fails if a planned pose is packed otherwise than a measured one."""
    rng = np.random.default_rng(2)
    points, rotations = rng.normal(size=(4, 3)), turned(rng, 4)
    rows = table(points, rotations)
    one = Pose.of(Series(), rows)
    np.testing.assert_allclose(one.expected(points, rotations), one.reported(rows), atol=1e-12)
    np.testing.assert_allclose(error(one, np.zeros(0), points, rows, rotations), 0, atol=1e-12)
    assert through_json(one) == one
