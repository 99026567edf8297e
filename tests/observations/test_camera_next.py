"""Next poses of a diagnosis by images: poses that part rivals show the target, by physics of their own."""

from __future__ import annotations

import numpy as np
import pandas as pd

from conftest import in_process
from observations.photographed import IN_HAND, ON_TABLE, SIZE, UR5E, Arm, Photographs, board, photographed
from observations.test_camera import study

BOARD = board(5, 4, 0.05)
ONLY = '\n[stages.diagnose]\ncatalogue = ["joint-eccentricity", "periodic-joint-error", "target-slip"]\n'


class Eccentric(Arm):
    """An arm whose joint 3 errs once a turn, by too little to be told from its rivals in few images."""

    def links(self, q):
        return super().links(q + np.eye(6)[2] * 4e-4 * np.cos(q[:, [2]] + 0.4))


def eccentric(folder) -> Photographs:
    """A study of photographs by such an arm."""
    rng = np.random.default_rng(7)
    worn = Eccentric(UR5E.worn(rng).figures, False, UR5E.limits)
    made = photographed(UR5E, True, 18, rng, points=BOARD, worn=worn)
    study(folder, made, "ur5e", True, ONLY)
    return made


def test_poses_that_part_rivals_show_the_target(tmp_path):
    """Fails if there are no poses to measure next, or the camera sees less than the whole board at some, or from behind."""
    made = eccentric(tmp_path)
    assert in_process("run", tmp_path / "study.toml", "--out", tmp_path / "runs").code == 0
    poses = pd.read_csv(tmp_path / "runs" / "diagnose" / "next_poses.csv")
    assert (poses["separation_after_sd"] > poses["separation_before_sd"]).all()
    readings = np.radians(poses.filter(regex=r"^q\d_deg").to_numpy())
    assert len(readings) > 5
    for seen in np.linalg.inv(made.arm.links(readings)[-1] @ IN_HAND) @ ON_TABLE:
        there = BOARD @ seen[:3, :3].T + seen[:3, 3]
        image = made.lens.image(there)
        assert (there[:, 2] > 0).all()
        assert ((image > 0) & (image < SIZE)).all()
        assert seen[2, 2] < 0  # from its front, where its z axis leads to the camera
