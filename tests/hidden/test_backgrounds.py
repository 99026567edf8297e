"""Backgrounds have the size asked for, are drawn by their seed, and are of the kinds that they are called."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hidden.backgrounds import KINDS, Background, crossed_joints, displaced
from hidden.case import Case, draw, write_case

SIZE = 2e-5  # m


def moved(kind: str, case: Case, seed: int = 1) -> np.ndarray:
    """How a background displaces the rows of a case."""
    world = draw(case, np.random.default_rng(0))
    return displaced(Background(kind, SIZE, seed), world.real, world.rows)


@pytest.mark.parametrize("robot", ["serial", "hh800"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_background_has_exactly_the_size_asked_and_is_drawn_by_its_seed(kind: str, robot: str) -> None:
    """Fails if a background is not scaled to its rms per axis, differs between two drawings, or is the same for two seeds."""
    case = Case(robot=robot, poses=40)
    shift = moved(kind, case)
    assert np.sqrt(np.mean(shift**2)) == pytest.approx(SIZE, rel=1e-12)
    np.testing.assert_array_equal(shift, moved(kind, case))
    assert abs(np.corrcoef(shift.ravel(), moved(kind, case, 2).ravel())[0, 1]) < 0.9


def test_the_kinds_are_distinct() -> None:
    """Fails if two kinds displace the rows alike."""
    shifts = [moved(kind, Case(poses=60)).ravel() for kind in KINDS]
    alike = np.abs(np.corrcoef(shifts)) - np.eye(len(shifts))
    assert alike.max() < 0.5


def test_markers_of_a_pose_share_their_error_and_poses_do_not() -> None:
    """Fails if a pose's markers err apart, or if the next pose errs as the one before."""
    shift = moved("shared", Case(poses=60, markers=3)).reshape(60, 3, 3)
    np.testing.assert_allclose(shift, shift[:, :1] + 0 * shift, atol=1e-12)
    own = shift[:, 0].ravel()
    assert abs(np.corrcoef(own[:-3], own[3:])[0, 1]) < 0.4


def test_a_drift_is_slow_and_the_same_wherever_the_robot_is() -> None:
    """Fails if one row's displacement says nothing of the next one's, though poses lie far apart."""
    shift = moved("drift", Case(poses=120))
    step, far = np.diff(shift, axis=0), np.diff(np.random.default_rng(0).permutation(shift), axis=0)
    assert np.mean(step**2) < 0.3 * np.mean(far**2)


def test_joints_err_with_no_other_angles_than_they_should() -> None:
    """Fails if the errors depend on joint 1 where it is not among their inputs: turning it turns the whole displacement."""
    background = Background("joints", SIZE, 2)
    assert all(one.driven != 0 and 0 not in one.inputs for one in crossed_joints(background, 6))
    before, after = about_joint_1(background)
    np.testing.assert_allclose(after, before, atol=1e-3 * SIZE)


def test_a_hose_loads_no_joint_before_its_anchor() -> None:
    """Fails if a hose within the arm turns the joints that carry it: joint 1 alone does not stretch it."""
    hoses = [Background("cable", SIZE, seed) for seed in range(12)]
    within = [hose for hose in hoses if hose.rng.integers(0, 3) > 0]  # the others hang above the base
    assert 3 < len(within) < len(hoses)
    for hose in within:
        before, after = about_joint_1(hose)
        np.testing.assert_allclose(after, before, atol=1e-3 * SIZE)


def about_joint_1(background: Background) -> tuple[np.ndarray, np.ndarray]:
    """How far each row's displacement is from the next one's (rows,), as the robot stands and with joint 1 turned throughout."""
    world = draw(Case(poses=20), np.random.default_rng(0))
    turned = world.rows.q + 0.5 * np.eye(6)[0]
    first, second = (displaced(background, world.real, replace(world.rows, q=q)) for q in (world.rows.q, turned))
    return np.linalg.norm(np.diff(first, axis=0), axis=1), np.linalg.norm(np.diff(second, axis=0), axis=1)


def test_a_background_is_in_what_is_written_and_nowhere_else(tmp_path: Path) -> None:
    """Fails if the measured points do not differ by the background alone: noise, poses and the robot are drawn as without it."""
    case, with_it = Case(poses=20), Background("cable", SIZE, 1)
    for name, one in (("without", case), ("with", replace(case, background=with_it))):
        write_case(tmp_path / name, one, np.random.default_rng(5))
    without, table = (pd.read_csv(tmp_path / name / "measurements.csv") for name in ("without", "with"))
    world = draw(case, np.random.default_rng(5))
    points = ["x_mm", "y_mm", "z_mm"]
    np.testing.assert_allclose(
        table[points] - without[points], 1e3 * displaced(with_it, world.real, world.rows), atol=2e-5
    )
    pd.testing.assert_frame_equal(table.drop(columns=points), without.drop(columns=points))
