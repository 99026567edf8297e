"""Drift of a run: check poses, a verdict, its files and its exit code."""

from __future__ import annotations

import pandas as pd

from applied import drift

X = ["x_mm", "y_mm", "z_mm"]


def test_a_line_stops_on_a_shifted_joint_and_goes_on_without(finished):
    """Fails if a shift of a joint's reading is not told with its joint and a correction, or a sound robot stops the line."""
    finished.edit("truth.toml", ("seed = 3", "seed = 6"), ("random = 40", "random = 10"))
    assert finished.calflow("simulate", finished / "truth.toml", "--out", finished / "new.csv").code == 0
    answer = finished.calflow("drift", finished / "runs", finished / "new.csv")
    assert (answer.code, answer.out.splitlines()[0]) == (0, "Nothing has moved that these check poses could show.")
    assert "95 of 100" in answer.out
    rows = pd.read_csv(finished / "new.csv")
    rows["q2_deg"] = rows["q2_deg"] - 0.05  # the robot is 0.05 degrees further than it says
    finished.measure(rows, "moved.csv")
    answer = finished.calflow("drift", finished / "runs", finished / "moved.csv")
    assert (answer.code, answer.out.splitlines()[0]) == (3, "Something has moved since the calibration.")
    folder = finished / "runs" / "drift" / "moved"
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    assert pd.read_csv(folder / "moved.csv")["joint"][0] == 2
    assert answer.err == ""
    finished.measure(rows.assign(q2_deg=-rows["q2_deg"]), "sign.csv")
    answer = finished.calflow("drift", finished / "runs", finished / "sign.csv", "--station", "known")
    assert answer.code in (3, 4)
    assert "off by more than any calibrated robot" in answer.err
    found = drift(finished / "runs", finished / "moved.csv")
    own = next(one for one in found.candidates if one.movement == "joint2.zero")
    assert abs(own.shifts[0] - 0.05 * 3.14159 / 180) < 4 * own.sds[0]
    assert (
        "expected 0.001 to 0.5"
        in finished.refused("drift", finished / "runs", finished / "moved.csv", "--false-alarm", "0.0005")[0]
    )
    rare = drift(finished / "runs", finished / "moved.csv", false_alarm=0.001)
    assert rare.summary.status == "moved"  # what is asked for can be found
    assert found.summary.left_mm < 0.5 * found.summary.error_mm
