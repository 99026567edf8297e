"""Real robots as their users have them: UR10 and UR5 diagnosed, next poses of the FANUC."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pandas as pd
import pytest

from calflow.stages.measuring_loop import next_poses
from calflow.study import load_study
from conftest import in_process, without_data
from test_studies import STUDIES, UR10, diagnosed, heldout, measured_data

SERIES = {
    "study.toml": ("series_c.csv", 8),
    "series_b.toml": ("series_b.csv", 4),
}  # its file; one pose of so many is kept
FEW = """
[stages.diagnose]
catalogue = ["joint-error-map", "joint-eccentricity"]
"""  # what acts in this robot, and a rival


@pytest.fixture(scope="module")
def thinned_ur10(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of the UR10's series C, confirmed by B, each thinned to some 350 poses."""
    folder = tmp_path_factory.mktemp("ur10")
    shutil.copy(UR10 / "robot.toml", folder)
    for study, (file, step) in SERIES.items():
        lines = (Path(os.environ["CALFLOW_DATA"]) / "ur10-tmac" / file).read_text(encoding="utf-8").splitlines(True)
        (folder / file).write_text("".join([lines[0], *lines[1::step]]), encoding="utf-8")
        text = (UR10 / study).read_text(encoding="utf-8").replace(f"ur10-tmac/{file}", file)
        own = [line for line in text.splitlines(True) if not line.startswith(("url = ", "sha256 = "))]
        (folder / study).write_text("".join(own) + FEW, encoding="utf-8")
    with without_data():
        answer = in_process("run", folder / "study.toml", "--out", folder / "run", "--stage", "diagnose")
    assert answer.code == 0, answer
    return folder / "run"


@measured_data
def test_real_ur10(thinned_ur10):
    """Fails if standard DH, the registration, the mapping or the estimated noise goes wrong on real data."""
    table = heldout(thinned_ur10)
    assert table.loc["geometry", "mean_mm"] <= 0.46
    assert table.loc["nominal", "mean_mm"] < 1.2


@measured_data
def test_real_ur10_is_diagnosed(thinned_ur10):
    """Fails if the transmission errors of the UR10's joints are missed, or gain nothing; the whole is benchmarks/whole_ur10.py."""
    found = pd.read_csv(thinned_ur10 / "diagnose" / "findings.csv")
    maps = found[found["cause"] == "joint-error-map"].set_index("joint")
    assert {1, 2, 3} <= set(maps.index)
    assert maps.loc[3, "status"] == "named"
    assert maps.loc[3, "gain_low_mm"] > 0.02
    steps = pd.read_csv(thinned_ur10 / "diagnose" / "accuracy.csv")
    assert steps.loc[steps["split"] == "holdout", "mean_mm"].iloc[-1] <= 0.16
    told = pd.read_csv(thinned_ur10 / "diagnose" / "confirmation.csv").set_index("joint")
    assert told.loc[3, "correlation"] >= 0.75
    assert "no reading of joint 1" in told.loc[1, "words"]


@measured_data
def test_real_ur5(tmp_path, monkeypatch):
    """Fails if a device that wandered while one series was measured is taken for where it stands in another."""
    held = diagnosed(
        "ur5", tmp_path, monkeypatch, "--stage", "diagnose", causes=["joint-error-map", "frame-drift"], every=2
    )
    assert held.iloc[1] <= 0.101
    assert held.iloc[-1] <= 0.06


@measured_data
def test_without_a_task_the_tool_is_judged_where_it_was_measured():
    """Fails if millimetres are told of where joint 1 never was, or of a suspicion that stays out of the model."""
    verdict = next_poses(load_study(STUDIES / "fanuc-r2000"), 2, 3e-4).verdict
    assert 0.4 * verdict.heldout_rms_mm < verdict.error_mm < 1.2 * verdict.heldout_rms_mm
    assert any("where it was measured" in note for note in verdict.notes)


@measured_data
def test_a_positioner_s_base_and_target_are_found(tmp_path, monkeypatch):
    """Fails if full poses do not say where base and target are, or poses that no fit has seen are missed by more than 0.36 mm."""
    few = ["joint-error-map", "joint-eccentricity", "frame-step"]  # of some forty that fanuc and the tutorial try
    held = diagnosed("positioner", tmp_path, monkeypatch, causes=few, every=2)
    assert held.iloc[0] < 0.45
    assert held.iloc[-1] <= 0.36
