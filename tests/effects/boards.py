"""What a printed board errs by: hidden in photographs of plates that are bent or printed wrong, by physics of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from conftest import in_process
from observations.photographed import UR5E, Photographs, board, photographed
from observations.test_camera import study

IMAGES = 18
BOARD = board(5, 4, 0.05)
CAUSES = ("board-bent", "print-scale", "camera-slip", "target-slip", "joint-eccentricity")
ONLY = f"\n[stages.diagnose]\ncatalogue = {[*CAUSES]}\n".replace("'", '"')


def of_plates(seed: int, *plates: np.ndarray) -> Photographs:
    """Photographs by a worn arm of plates, one after another, whose points (20, 3) [m] are not where the file has them."""
    rng, tables = np.random.default_rng(seed), []
    worn = UR5E.worn(rng)
    for k, plate in enumerate(plates):
        made = photographed(UR5E, True, IMAGES, rng, points=plate, worn=worn)
        real = made.rows[["px_x_mm", "px_y_mm", "px_z_mm"]].to_numpy()
        which = np.linalg.norm(real[:, None] - 1e3 * plate, axis=2).argmin(axis=1)
        made.rows[["px_x_mm", "px_y_mm", "px_z_mm"]] = 1e3 * BOARD[which]
        tables.append(made.rows.assign(pose=made.rows["pose"] + k * IMAGES, target=f"board{k + 1}"))
    return replace(made, rows=pd.concat(tables, ignore_index=True))


def findings_of(folder, made: Photographs, more: str = ONLY) -> pd.DataFrame:
    """What a run names, by cause."""
    study(folder, made, "ur5e", True, more)
    assert in_process("run", folder / "study.toml", "--out", folder / "runs").code == 0
    return pd.read_csv(folder / "runs" / "diagnose" / "findings.csv").set_index("cause")
