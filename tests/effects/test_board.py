"""What a printed board errs by: hidden in photographs of plates that are bent or printed wrong, by physics of their own."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from conftest import in_process
from observations.photographed import UR5E, Photographs, board, photographed
from observations.test_camera import study

IMAGES = 30
BOARD = board(5, 4, 0.05)
CAUSES = ("board-bent", "print-scale", "camera-slip", "target-slip", "joint-eccentricity")
ONLY = f"\n[stages.diagnose]\ncatalogue = {[*CAUSES]}\n".replace("'", '"')


def of_plate(seed: int, plate: np.ndarray) -> Photographs:
    """Photographs by a worn arm of a plate whose points (20, 3) [m] are not where the file says that they are."""
    made = photographed(UR5E, True, IMAGES, np.random.default_rng(seed), points=plate)
    real = made.rows[["px_x_mm", "px_y_mm", "px_z_mm"]].to_numpy()
    which = np.linalg.norm(real[:, None] - 1e3 * plate, axis=2).argmin(axis=1)
    made.rows[["px_x_mm", "px_y_mm", "px_z_mm"]] = 1e3 * BOARD[which]
    return made


def found(folder, made: Photographs, more: str = ONLY) -> pd.DataFrame:
    """What a run names, by cause."""
    study(folder, made, "ur5e", True, more)
    assert in_process("run", folder / "study.toml", "--out", folder / "runs").code == 0
    return pd.read_csv(folder / "runs" / "diagnose" / "findings.csv").set_index("cause")


def bent(by: float) -> np.ndarray:
    """A plate bowed along x by so much at 0.1 m from its middle, and twisted by half of that [m]."""
    x, y = (BOARD[:, :2] - BOARD[:, :2].mean(axis=0)).T / 0.1
    return BOARD + np.column_stack([0 * x, 0 * x, by * (x**2 + 0.5 * x * y)])


def test_a_plate_that_is_not_flat_is_found(tmp_path):
    """Fails if a bowed plate is missed, taken for another cause, or its height is not the plate's."""
    only = found(tmp_path, of_plate(11, bent(3e-4)))
    assert [*only.index] == ["board-bent"]
    assert only.loc["board-bent", "estimate"] == pytest.approx(
        3e-4 * np.hypot(1, 0.5), abs=4 * only.loc["board-bent", "sd"]
    )
    assert only.loc["board-bent", "sd"] < 3e-5
    assert only.loc["board-bent", "heldout_mean"] < 0.3


def test_a_print_that_is_longer_one_way_is_found(tmp_path):
    """Fails if a stretched print is missed, or the stretch is not how much longer it is one way than the other."""
    only = found(tmp_path, of_plate(12, BOARD * [1.0, 1.003, 1.0]))
    assert [*only.index] == ["print-scale"]
    assert only.loc["print-scale", "estimate"] == pytest.approx(3e-3, abs=4 * only.loc["print-scale", "sd"])
    assert only.loc["print-scale", "sd"] < 3e-4


def test_a_print_that_is_too_large_all_over_is_not_told_from_longer_links(tmp_path):
    """Fails if a cause is named for what any camera sees alike: a larger print before a larger robot."""
    assert found(tmp_path, of_plate(13, BOARD * [1.003, 1.003, 1.0])).empty


def test_a_good_board_is_not_blamed(tmp_path):
    """Fails if the errors of a worn arm are taken for the board's."""
    assert found(tmp_path, of_plate(14, BOARD)).empty
