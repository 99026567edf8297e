"""Growth of a lens: hidden in photographs by a camera that warms up, whose images grow about a centre that moves.

Two cameras of which one warms up are in benchmarks/slow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.effects.device_growth import LensGrowth
from conftest import in_process
from observations.photographed import UR5E, Photographs, board, photographed
from observations.test_camera import study

IMAGES, EVERY, CONSTANT = 20, 72.0, 600.0  # s between images, and of the warm-up
FOCAL, CENTRE = 3e-3, np.array([8e-4, -6e-4])  # relative growth; shift in focal lengths
ONLY = '\n[stages.diagnose]\ncatalogue = ["lens-growth", "stand-growth", "frame-drift", "camera-slip", "joint-eccentricity"]\n'


def warming(seed: int, focal: float, centre: np.ndarray, cameras: int = 1) -> Photographs:
    """Photographs of a worn arm by cameras in turn, the last of whose lens grows and image's centre moves as it warms up."""
    made = photographed(UR5E, True, cameras * IMAGES, np.random.default_rng(seed), points=board(4, 3, 0.07))
    rows = made.rows
    rows["time_s"] = EVERY * (rows["pose"] - 1) / cameras
    rows["camera"] = [f"camera{1 + pose % cameras}" for pose in rows["pose"]]
    grown = (1 - np.exp(-rows["time_s"].to_numpy() / CONSTANT)) * (rows["camera"] == f"camera{cameras}")
    for name, middle, length, moved in zip(("u_px", "v_px"), made.lens.centre, made.lens.focal, centre, strict=True):
        rows[name] = middle + (rows[name] - middle) * (1 + focal * grown) + moved * length * grown
    return made


def findings(folder, made: Photographs) -> pd.DataFrame:
    """What a run names, by cause."""
    study(folder, made, "ur5e", True, ONLY)
    assert in_process("run", folder / "study.toml", "--out", folder / "runs").code == 0
    return pd.read_csv(folder / "runs" / "diagnose" / "findings.csv").set_index("cause")


def test_a_lens_that_warms_up_is_no_camera_that_moves(tmp_path):
    """Fails if a growing image is taken for a camera that creeps, or for growth of another size."""
    assert_grown(findings(tmp_path, warming(7, FOCAL, CENTRE)), ")")


def assert_grown(found: pd.DataFrame, of: str) -> None:
    """One growth is named, as large as the hidden one, and what it is of."""
    assert [*found.index] == ["lens-growth"]
    lens = found.loc["lens-growth"]
    assert f" h{of}" in lens["statement"]
    assert lens["status"] == "named"
    assert lens["estimate"] == pytest.approx(np.hypot(FOCAL, np.linalg.norm(CENTRE)), abs=4 * lens["sd"])
    assert lens["sd"] < 3e-4


def test_growth_is_looked_for_where_something_tells_of_warmth(tmp_path):
    """Fails if a growing lens is looked for where nothing tells of warmth."""
    made = warming(8, 0.0, 0 * CENTRE)
    kept = study(tmp_path, replace(made, rows=made.rows.drop(columns="time_s")), "ur5e", True)
    assert "time_s" in LensGrowth.lacking(kept.robot, kept.measurements())
