"""Alignment: a device that stood elsewhere is put back, and what that takes off the errors is put on again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.deployment.attained import CALIBRATED, Alignment, Attained, can_align, errors_left_out, restored


def test_a_motion_is_found_and_undone():
    """Fails if points that moved rigidly do not come back, or how far they went is not said."""
    rng = np.random.default_rng(2)
    expected = rng.uniform(-1, 1, (8, 3))
    turn = Rotation.from_rotvec([0.3, -0.2, 1.0])
    measured = turn.apply(expected) + np.array([5.0, 1.0, -2.0])
    found = Alignment.best(measured, expected)
    np.testing.assert_allclose(found.of(measured), expected, atol=1e-12)
    assert abs(found.angle - turn.magnitude()) < 1e-9


def test_errors_are_as_large_as_before_the_frame_was_fitted():
    """Fails if six numbers fitted to five poses make a robot look better: the mean square error must stay what it was."""
    rng = np.random.default_rng(3)
    expected = rng.uniform(-1, 1, (5, 3))
    left, made = [], []
    for noise in 1e-3 * rng.standard_normal((400, 5, 3)):
        fit = Alignment.best(expected + noise, expected)
        error = fit.of(expected + noise) - expected
        left.append((error**2).mean())
        made.append((restored(error, expected) ** 2).mean())
    assert np.mean(left) < 0.65e-6
    assert 0.95e-6 < np.mean(made) < 1.05e-6


def test_a_pose_left_out_errs_as_a_further_one_does():
    """Fails if a pose helps the frame in which it is judged, or two points of one pose help each other's."""
    rng = np.random.default_rng(4)
    expected = rng.uniform(-1, 1, (12, 3))
    pose, near, later = np.repeat(np.arange(5), 2), np.arange(10), np.arange(10, 12)
    left_out, further = [], []
    for noise in 1e-3 * rng.standard_normal((600, 12, 3)):
        noise[1:10:2] = noise[0:10:2]  # the two points of a pose err alike
        measured = expected + noise
        frame = Alignment.best(measured[near], expected[near])
        left_out.append((errors_left_out(measured[near], expected[near], pose) ** 2).mean())
        further.append(((frame.of(measured[later]) - expected[later]) ** 2).mean())
    assert 0.9 < np.mean(left_out) / np.mean(further) < 2.0
    assert np.isnan(errors_left_out(expected[:3], expected[:3], np.arange(3))).all()


def test_points_on_a_line_show_no_frame():
    """Fails if a frame is fitted whose turn nothing shows."""
    line = np.linspace(0, 1, 6)[:, None] * [1.0, 2.0, 0.5]
    assert not can_align(line)
    assert not can_align(np.eye(3))
    assert can_align(np.vstack([line, [1.0, 0.0, 0.0]]))


def _of_a_bent_robot(rng: np.random.Generator, fitted: bool) -> tuple[Attained, np.ndarray, float]:
    """Return 30 points where they are expected, the loadings of the errors that they share, and their noise [m]."""
    place, noise = rng.uniform(-1, 1, (30, 3)), 5e-5
    turned = np.cross(np.eye(3)[None], place[:, None]).transpose(0, 2, 1)  # of a base that is known to 2 mrad and 2 mm
    bent = 2e-4 * np.sin(2 * place)[:, :, None] * np.eye(3)
    shared = np.concatenate([2e-3 * turned, np.tile(2e-3 * np.eye(3), (30, 1, 1)), bent], axis=2)
    points = np.arange(30)
    table = pd.DataFrame({"pose": points, "marker": "tool", "payload": "", "rows": 1})
    apart, each = np.full(30, np.sqrt(3) * noise), np.full(30, noise)
    once = np.full(30, np.nan)
    seen = Attained(table, points, place, {CALIBRATED: place}, shared, apart, each, once, None, np.array([fitted]))
    return seen, shared, noise


def test_a_motion_is_held_against_how_well_the_base_is_known():
    """Fails if a base that is known to 2 mrad and 2 mm passes for one that moved, or one that moved by 20 mm does not."""
    rng = np.random.default_rng(6)
    seen, shared, noise = _of_a_bent_robot(rng, fitted=False)
    chances = []
    for _ in range(400):
        error = shared @ rng.standard_normal(9) + noise * rng.standard_normal((30, 3))
        chances.append(replace(seen, measured=seen.measured + error).motion_p)
    assert 0.02 < np.mean(np.array(chances) < 0.05) < 0.09
    assert replace(seen, measured=seen.measured + np.array([0.02, 0, 0])).motion_p < 1e-6


def test_what_a_fitted_frame_takes_away_is_not_promised():
    """Fails if a station placed anew is promised the error of the place that the calibration had, or less than it will show."""
    rng = np.random.default_rng(5)
    seen, shared, noise = _of_a_bent_robot(rng, fitted=True)
    draws = [
        replace(seen, measured=seen.measured + shared @ rng.standard_normal(9) + noise * rng.standard_normal((30, 3)))
        for _ in range(200)
    ]
    found = np.sqrt(np.mean([one.errors(CALIBRATED) ** 2 for one in draws], axis=0).sum(axis=1))
    np.testing.assert_allclose(seen.promised, found, rtol=0.3)
    assert abs(np.sqrt((seen.promised**2).mean()) / np.sqrt((found**2).mean()) - 1) < 0.1
    assert replace(seen, fitted=~seen.fitted).promised.min() > 2e-3
