"""Real robots as their users have them: the UR5 diagnosed, whose device wandered in one series, and next poses of the FANUC."""

from __future__ import annotations

from calflow.stages.measuring_loop import next_poses
from calflow.study import load_study
from test_studies import STUDIES, diagnosed, measured_data


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
