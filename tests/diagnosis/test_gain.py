"""The gain's interval covers what an extension is worth, and counts poses, not rows."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.estimation.accuracy import gain
from calflow.measurements.measurements import Measurements
from robots import industrial


@pytest.fixture(scope="module")
def robot():
    return industrial()


def rows(robot, poses, payloads=("none", "full"), each=1):
    """Held-out rows, so many of each pose, the payloads in turn."""
    pose = np.repeat(np.arange(poses), each)
    return Measurements(robot, pd.DataFrame({"pose": pose, "payload": np.array(payloads)[pose % len(payloads)]}))


def test_the_interval_covers_the_true_gain_as_often_as_it_says(robot):
    """Fails if the interval is for single rows, for another sign, or narrower than poses drawn anew would make it."""
    rng = np.random.default_rng(1)
    heldout, before, after = rows(robot, 50, each=3), 2e-4, np.array([1.9e-4, 1e-4])
    truth = np.sqrt(8 / np.pi) * (before - after.mean())  # mean length of a normal vector
    covered, means = [], []
    for _ in range(250):
        own = after[np.arange(50) % 2][:, None]
        errors = [np.repeat(size * rng.standard_normal((50, 3)), 3, axis=0) for size in (before, own)]
        mean, low, high = gain(*errors, heldout, rng)
        assert low < mean < high
        covered.append(low < truth < high)
        means.append(mean)
    assert 0.91 < np.mean(covered) < 0.98
    assert np.mean(means) == pytest.approx(truth, rel=0.03)


def test_rows_of_one_pose_count_once(robot):
    """Fails if repeats of a pose are resampled apart, as if they were so much more evidence."""
    rng = np.random.default_rng(2)
    before, after = 2e-4 * rng.standard_normal((2, 40, 3))
    single = gain(before, 0.5 * after, rows(robot, 40), np.random.default_rng(3))
    fivefold = gain(
        np.repeat(before, 5, axis=0),
        np.repeat(0.5 * after, 5, axis=0),
        rows(robot, 40, each=5),
        np.random.default_rng(3),
    )
    for one, five in zip(single, fivefold, strict=True):
        assert five == pytest.approx(one, rel=1e-9)


def test_a_pose_with_more_rows_weighs_more(robot):
    """Fails if the mean is one of poses while the interval is one of rows, or the other way about."""
    rng = np.random.default_rng(4)
    pose = np.repeat(np.arange(60), np.where(np.arange(60) < 30, 1, 9))
    heldout = Measurements(robot, pd.DataFrame({"pose": pose, "payload": ""}))
    size = np.where(pose < 30, 3e-4, 1e-4)[:, None] + 1e-6 * rng.standard_normal((len(pose), 1))
    mean, low, high = gain(size * [1.0, 0.0, 0.0], np.zeros((len(pose), 3)), heldout, rng)
    assert mean == pytest.approx((30 * 3e-4 + 270 * 1e-4) / 300, rel=1e-2)
    assert low < mean < high


def test_payloads_keep_their_shares(robot):
    """Fails if a resample may hold more poses under one payload than were measured."""
    heldout = rows(robot, 30)
    before = np.where(heldout.table[["payload"]] == "full", 1e-3, 2e-4) * np.array([0.0, 1.0, 0.0])
    found = gain(before, np.zeros_like(before), heldout, np.random.default_rng(5))
    assert found == pytest.approx([6e-4] * 3)


def test_an_extension_that_harms_has_a_negative_gain(robot):
    """Fails if before and after change places."""
    rng = np.random.default_rng(6)
    before, after = 1e-4 * rng.standard_normal((2, 60, 3))
    assert gain(before, 3 * after, rows(robot, 60), rng)[2] < 0


def test_without_held_out_rows_there_is_no_gain(robot):
    """Fails if a gain of zero is claimed, or the stage breaks, where no pose is held out."""
    empty = rows(robot, 10).only(np.zeros(10, dtype=bool))
    found = gain(np.empty((0, 3)), np.empty((0, 3)), empty, np.random.default_rng(7))
    assert np.isnan(found).all()


def test_poses_are_resampled_within_their_session(robot):
    """Fails if a session that was worse throughout widens the interval, as if the sessions had been drawn too."""
    rng = np.random.default_rng(7)
    heldout, late = rows(robot, 60, payloads=("",)), np.arange(60) >= 30
    before = 2e-4 * rng.standard_normal((60, 3)) * np.where(late, 5.0, 1.0)[:, None]
    parted = Measurements(robot, heldout.table.assign(session=np.where(late, "after the rebuild", "before")))
    whole, within = (gain(before, 0.5 * before, one, np.random.default_rng(8)) for one in (heldout, parted))
    assert within[0] == whole[0]
    assert np.ptp(within[1:]) < 0.8 * np.ptp(whole[1:])
