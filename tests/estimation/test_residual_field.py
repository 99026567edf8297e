"""The residual field by itself: what it learns from functions of NumPy's alone, how sure it is of that, and where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.field_gain import blocks, field_summary, gain_of
from calflow.estimation.residual_field import SUMMARY, learnt, pose_table, read_field
from calflow.files.tables import Results, to_document
from robots import hh800

NOISE, POSES = 5e-5, 250
LOW, HIGH = np.array([-1.0, -0.5, 0.0, -2.0]), np.array([1.0, 0.8, 1.5, 2.0])


def smooth(q):
    """What is hidden [m]: it changes with three of four joints, and is the same function anywhere."""
    return 3e-4 * np.stack([np.sin(2 * q[:, 0]), np.cos(q[:, 1] - 2 * q[:, 2]), np.sin(q[:, 0] + q[:, 2])], axis=1)


def drawn(n, seed):
    """Readings within the measured range, and what was left there, with noise."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(LOW, HIGH, (n, 4))
    return q, smooth(q) + NOISE * rng.standard_normal((n, 3))


@pytest.fixture(scope="module")
def field():
    """A field of the hidden function."""
    return learnt(*drawn(POSES, 1), NOISE, np.random.default_rng(2))


def test_a_smooth_function_is_found_and_its_errors_are_as_large_as_said(field):
    """Fails if the field misses the function, or its standard deviations are too small or too large."""
    q, left = drawn(1000, 3)
    off = left - field.correction(q)
    assert np.sqrt(np.mean(off**2)) < 0.4 * np.sqrt(np.mean(left**2))
    covered = np.mean(np.abs(off) < 1.96 * np.sqrt(field.left_of(np.zeros_like(off), q) + NOISE**2))
    assert 0.92 < covered < 0.98


def test_it_fades_to_nothing_outside_and_says_so(field):
    """Fails if a correction is made where nothing was measured, jumps at the edge, or is promised to help there."""
    q, _ = drawn(200, 4)
    inside = np.sqrt(np.mean(field.correction(q) ** 2))
    for joint in range(4):
        outside = q.copy()
        outside[:, joint] = HIGH[joint] + 0.15 * (HIGH - LOW)[joint]
        assert np.abs(field.correction(outside)).max() < 0.05 * inside
        for variance in (0.0, 4 * field.size**2):
            promised = field.left_of(np.full((200, 3), variance), outside)
            np.testing.assert_allclose(promised, max(variance, field.size**2 + field.own**2), rtol=1e-6)
    across = np.tile(q[0], (2000, 1))
    across[:, 2] = np.linspace(HIGH[2] - 0.1, HIGH[2] + 0.4, 2000)
    assert np.abs(np.diff(field.correction(across), axis=0)).max() < 0.02 * inside


def test_it_takes_no_more_off_a_promise_than_it_explains(field):
    """Fails if what the field cannot know, as the error under another payload, passes for known near a measured pose."""
    q, _ = drawn(200, 13)
    doubt = (20 * field.size) ** 2
    left = field.left_of(np.full((200, 3), doubt), q)
    assert (left >= doubt - field.size**2).all()
    assert (left < doubt).all()


def test_left_out_blocks_see_what_is_gained():
    """Fails if blocks are single poses that have their twins beside them, or a gain is not seen with them."""
    q, left = drawn(POSES, 6)
    block = blocks(q)
    assert np.bincount(block).min() >= 4
    assert np.mean([np.ptp(q[block == k], axis=0) < HIGH - LOW for k in range(block.max() + 1)]) > 0.5
    gain = gain_of(q, left, NOISE, np.random.default_rng(7))
    assert gain.gains
    assert "not physical" in gain.statement
    assert np.mean(gain.corrected**2) < 0.5 * np.mean(gain.without**2)
    assert 0.9 < gain.covered < 0.99


def test_too_few_poses_are_said_to_be_too_few():
    """Fails if a field is learnt from a handful of poses."""
    q, left = drawn(12, 8)
    gain = gain_of(q, left, NOISE, np.random.default_rng(9))
    assert not gain.gains
    assert "12 poses" in gain.statement


def test_a_run_folder_keeps_all_of_it():
    """Fails if what predict rebuilds from the tables is another field than the one that was learnt."""
    robot = hh800()
    rng = np.random.default_rng(10)
    q = rng.uniform(-1, 1, (40, robot.n_joints))
    left = 1e-4 * np.stack([np.sin(3 * q[:, 0]), q[:, 1] ** 2, q[:, 2]], axis=1)
    own = learnt(q, left, 1e-5, rng)
    told = to_document(field_summary(own, gain_of(q, left, 1e-5, rng)))
    read = read_field(Results({"residual_field/poses.csv": pose_table(own, robot)}, {SUMMARY: told}), robot)
    assert read is not None
    there = rng.uniform(-1.2, 1.2, (50, robot.n_joints))
    np.testing.assert_allclose(read.correction(there), own.correction(there), atol=1e-10)
    nothing = np.zeros((50, 3))
    np.testing.assert_allclose(read.left_of(nothing, there), own.left_of(nothing, there), rtol=1e-6)


def test_lengths_are_those_from_before_a_model_took_its_share():
    """Fails if what the parameters took off, which is the smoothest part, makes what is left pass for rough."""
    rng = np.random.default_rng(11)
    q = rng.uniform(-2, 2, (120, 3))
    likeness = np.exp(-0.5 * ((q[:, None] - q)[:, :, :2] ** 2).sum(axis=2) / 1.5**2)
    left = 1e-4 * np.linalg.cholesky(likeness + 1e-9 * np.eye(120)) @ rng.standard_normal((120, 3))
    left += 1e-5 * rng.standard_normal((120, 3))
    waves = np.hstack([np.ones((120, 1)), *(wave(k * q) for k in (0.5, 1) for wave in (np.cos, np.sin))])
    moved = np.einsum("nk,ac->nakc", waves, np.eye(3)).reshape(120, 3, -1)
    columns = moved.reshape(360, -1)
    taken = columns @ np.linalg.lstsq(columns, left.ravel())[0]
    whole = learnt(q, left, 0.0, rng)
    beside = learnt(q, left - taken.reshape(120, 3), 0.0, rng, moved)
    assert beside.length[:2] == pytest.approx(whole.length[:2], rel=0.15)
    assert beside.size == pytest.approx(whole.size, rel=0.15)  # 0.67 of it from what is left alone


def test_lengths_beside_wide_nearly_dependent_priors():
    """Fails if rounding in products of such priors, as of a base and a tool that imitate each other, ends the search."""
    rng = np.random.default_rng(12)
    q = rng.uniform(-2, 2, (60, 2))
    likeness = np.exp(-0.5 * ((q[:, None] - q) ** 2).sum(axis=2) / 1.5**2)
    left = 1e-4 * np.linalg.cholesky(likeness + 1e-9 * np.eye(60)) @ rng.standard_normal((60, 3))
    left += 1e-5 * rng.standard_normal((60, 3))
    base = np.broadcast_to(100 * np.eye(3), (60, 3, 3))
    tool = base + 1e-4 * rng.standard_normal((60, 3, 3))
    once = learnt(q, left, 0.0, rng, base)
    twice = learnt(q, left, 0.0, rng, np.concatenate([base, base, tool], axis=2))
    assert twice.length == pytest.approx(once.length, rel=0.1)
    assert twice.size == pytest.approx(once.size, rel=0.1)
