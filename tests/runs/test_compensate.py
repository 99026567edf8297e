"""Compensation from a run folder: a CSV of targets becomes a CSV of commands that `predict` finds on target."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

X = ["x_mm", "y_mm", "z_mm"]
Q = ["q1_deg", "q2_deg", "q3_deg"]
FRAMES = """\
[frames.bench]
within = "base"
origin_mm = [100, 0, 0]
rotation_deg = [0, 0, 90]
"""


@pytest.fixture
def asked(finished):
    """Some measured places as targets, with names and payloads; the last is in another hall."""
    rows = finished.rows[:8:2].drop(columns=["sigma_mm", "repeat"]).assign(pose=["P1", "P2", "P3", "P4"])
    rows.loc[rows.index[-1], "x_mm"] = "9000"
    finished.measure(rows, "targets.csv")
    return rows


def test_commands_land_where_predict_says(finished, asked):
    """Fails if commands are of another model, payload or unit than predictions, or one out of reach is commanded."""
    answer = finished.calflow("compensate", finished / "runs", finished / "targets.csv", "--out", finished / "c.csv")
    assert answer.code == 3, answer
    printed = finished.calflow("compensate", finished / "runs", finished / "targets.csv")
    assert (printed.code, printed.out) == (3, (finished / "c.csv").read_text(encoding="utf-8"))
    assert "pose P4" in answer.err
    assert "3 of 4 targets reached" in answer.out
    commands = pd.read_csv(finished / "c.csv")
    assert list(commands["reached"]) == [True, True, True, False]
    assert commands[Q].iloc[3].isna().all()
    np.testing.assert_array_equal(commands["nominal_q1_deg"], asked["q1_deg"].astype(float))
    landed = commands[:3]
    finished.measure(landed[["pose", "payload", "marker", *Q]], "rows.csv")
    assert finished.calflow("predict", finished / "runs", finished / "rows.csv", "--out", finished / "p.csv").code == 0
    predicted = pd.read_csv(finished / "p.csv")
    np.testing.assert_allclose(predicted[X], landed[X], atol=1e-3)
    expected = np.sqrt((predicted[["sd_x_mm", "sd_y_mm", "sd_z_mm"]] ** 2).sum(axis=1))
    np.testing.assert_allclose(landed["expected_mm"], expected, rtol=1e-3)


def test_commands_that_gain_nothing_for_certain_say_so(finished, asked):
    """Fails if targets where the readings already lead, by the model, look worse with commands, and nothing says why."""
    finished.measure(asked[["pose", "payload", "marker", *Q]], "rows.csv")
    assert finished.calflow("predict", finished / "runs", finished / "rows.csv", "--out", finished / "p.csv").code == 0
    finished.measure(pd.read_csv(finished / "p.csv")[["pose", "payload", "marker", *Q, *X]], "p.csv")
    for file, told in (("targets.csv", False), ("p.csv", True)):
        answer = finished.calflow(
            "compensate", finished / "runs", finished / file, "--out", finished / "c.csv", "--force"
        )
        assert ("no gain is certain" in answer.out) == told


def test_a_user_s_own_file_is_not_written_over(finished, asked):
    """Fails if --out may name the file that is read, which would be gone."""
    before = (finished / "targets.csv").read_bytes()
    for command in ("compensate", "predict"):
        answer = finished.calflow(
            command, finished / "runs", finished / "targets.csv", "--out", finished / "targets.csv"
        )
        assert answer.code == 2
        assert "would write over" in answer.err
    assert (finished / "targets.csv").read_bytes() == before


def test_readings_past_a_limit_and_frames_of_taken_names_are_told(finished, asked):
    """Fails if a start that the robot cannot have is cut off without a word, or the base is another than calibrated."""
    finished.measure(asked.assign(q1_deg=["200", *asked["q1_deg"][1:]]), "targets.csv")
    answer = finished.calflow("compensate", finished / "runs", finished / "targets.csv", "--out", finished / "c.csv")
    assert "joint 1 is past its limits in line 2: the way to the target begins at the limit" in answer.err
    (finished / "frames.toml").write_text("[frames.base]\norigin_mm = [1, 0, 0]\n", encoding="utf-8")
    (told,) = finished.refused(
        "compensate", finished / "runs", finished / "targets.csv", "--frames", finished / "frames.toml"
    )
    assert "frame 'base' is known without being stated" in told


def test_a_run_of_lengths_says_what_frame_its_places_are_in(finished, asked):
    """Fails if places in a tracker's frame are taken for those in the robot's base without a word."""
    rows = finished.rows
    length = np.linalg.norm(rows[X].astype(float) - [1200.0, 500.0, -300.0], axis=1)
    finished.measure(rows.drop(columns=[*X, "sigma_mm"]).assign(length_mm=length), "wire.csv")
    finished.edit(
        "study.toml", ('file = "measurements.csv"', 'file = "wire.csv"\nkind = "distance"\nsigma_mm = 0.03\n'
                       "[measurements.settings]\nanchor_mm = [1200, 500, -300]\nanchor_known = false")
    )  # fmt: skip
    assert finished.calflow("run", "--stage", "identify", "--out", finished / "wire").code == 0
    finished.measure(asked.drop(columns=X), "rows.csv")
    for command, file in (("compensate", "targets.csv"), ("predict", "rows.csv")):
        answer = finished.calflow(command, finished / "wire", finished / file)
        assert "the robot's own base stands in for the measuring frame" in answer.err
        assert "own base" not in finished.calflow(command, finished / "runs", finished / file).err


def test_targets_may_be_in_frames_and_without_readings(finished, asked):
    """Fails if a frame of the user's is not applied, or rows need the nominal robot's readings."""
    (finished / "frames.toml").write_text(FRAMES, encoding="utf-8")
    bench = asked[:1].drop(columns=Q)
    base = bench.assign(frame="base", x_mm=100 - bench["y_mm"].astype(float), y_mm=bench["x_mm"])
    finished.measure(pd.concat([base, bench.assign(frame="bench")]).assign(pose=["in base", "in bench"]), "t.csv")
    command = ("compensate", finished / "runs", finished / "t.csv", "--frames", finished / "frames.toml")
    answer = finished.calflow(*command, "--out", finished / "c.csv")
    assert answer.code == 0, answer
    assert "no columns q1" in answer.err
    commands = pd.read_csv(finished / "c.csv")
    assert commands["reached"].all()
    np.testing.assert_allclose(commands[Q].iloc[0], commands[Q].iloc[1], atol=1e-3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x_mm,y_mm\n1,2\n", "targets.csv:1: missing column: expected z_m or z_mm"),
        ("x_mm,y_mm,z_mm,q1_deg\n1,2,3,4\n", "targets.csv:1: missing column: expected q2_rad or q2_deg"),
        ("x_mm,y_mm,z_mm,payload\n1,2,,\n", "targets.csv:2: column 'z_mm' is empty or not a number"),
        (
            "x_mm,y_mm,z_mm,payload,frame\n600,2,800,,fixture\n",
            "frame: unknown frame 'fixture': expected one of measuring, base",
        ),
    ],
)
def test_wrong_targets_are_refused(finished, text, expected):
    """Fails if commands are made for targets that say something else or nothing."""
    (finished / "targets.csv").write_text(text, encoding="utf-8")
    told = finished.refused("compensate", finished / "runs", finished / "targets.csv", "--out", finished / "c.csv")
    assert expected in told[0]
    assert not (finished / "c.csv").exists()
