"""Validation of a run: new measurements, a verdict, its files and its exit code."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from applied import predict, validate

X = ["x_mm", "y_mm", "z_mm"]


@pytest.fixture
def measured(finished):
    """Other poses of the same robot, measured twice, as a file beside the run."""
    finished.edit("truth.toml", ("seed = 3", "seed = 4"), ("random = 40", "random = 12"))
    assert finished.calflow("simulate", finished / "truth.toml", "--out", finished / "new.csv").code == 0
    return finished


def test_a_sound_robot_meets_its_tolerance_and_a_tight_one_is_not_met(measured):
    """Fails if the verdict, its exit code or the files that a line would read are not those of the errors."""
    answer = measured.calflow("validate", measured / "runs", measured / "new.csv", "--tolerance-mm", 1)
    assert (answer.code, answer.out.splitlines()[0]) == (0, "The tolerance is met.")
    folder = measured / "runs" / "validate" / "new"
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    accuracy = pd.read_csv(folder / "accuracy.csv").set_index("model")
    assert accuracy.loc["calibrated", "mean_mm"] < 0.1 < accuracy.loc["nominal", "mean_mm"]
    assert accuracy.loc["calibrated", "mean_low_mm"] < accuracy.loc["calibrated", "mean_mm"]
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert (summary["poses"], summary["rows"], summary["station"]) == (12, 24, "known")
    assert min(summary["further_within"], summary["task_within"]) > 0.95
    tight = validate(measured / "runs", measured / "new.csv", tolerance=1e-6)
    assert tight.summary.status == "not met"
    between = validate(measured / "runs", measured / "new.csv", tolerance=tight.judged.max_mm / 1e3)
    assert between.summary.status == "cannot be told"
    told = measured.calflow(
        "validate", measured / "runs", measured / "new.csv", "--tolerance-mm", 0.001, "--out", measured / "v"
    )
    assert told.code == 3


def test_the_calibration_s_own_file_is_no_proof(measured):
    """Fails if the measurements that the robot was fitted to pass for new ones, or new ones are taken for them."""
    own = measured.calflow("validate", measured / "runs", measured / "measurements.csv", "--out", measured / "own")
    assert "note: measurements.csv is the very file that the calibration was made of" in own.err
    moved = measured.calflow("drift", measured / "runs", measured / "measurements.csv", "--out", measured / "own-drift")
    assert "measurements.csv is the very file that the calibration was made of" in moved.err
    lines = (measured / "measurements.csv").read_text().splitlines()
    (measured / "own.csv").write_text("\n".join(lines[:40]))
    proof = measured.calflow("validate", measured / "runs", measured / "own.csv", "--tolerance-mm", 1)
    assert proof.code == 2
    assert proof.err.startswith(f"{measured / 'own.csv'}: ")
    assert "were fitted and prove nothing" in proof.err
    new = measured.calflow("validate", measured / "runs", measured / "new.csv", "--out", measured / "new")
    assert "the very file" not in new.err


def test_errors_are_the_barycentres_distances(measured):
    """Fails if AP is not that of the rows as `predict` has them, or RP not that of the rows as measured."""
    found = validate(measured / "runs", measured / "new.csv")
    rows = pd.read_csv(measured / "new.csv")
    measured.measure(rows.drop(columns=[*X, "sigma_mm"]), "asked.csv")
    predicted = predict(measured / "runs", measured / "asked.csv")
    error = (rows[X] - predicted[X]).assign(pose=rows["pose"]).groupby("pose").mean()
    size = np.linalg.norm(error, axis=1)
    np.testing.assert_allclose([one.calibrated_mm for one in found.poses], size, atol=1e-6)
    own = rows.loc[rows["pose"] == rows["pose"][0], X].to_numpy()
    distance = np.linalg.norm(own - own.mean(axis=0), axis=1)
    assert found.poses[0].rp_mm == pytest.approx(distance.mean() + 3 * distance.std(ddof=1), abs=1e-9)
    assert found.judged.mean_mm == pytest.approx(size.mean(), abs=1e-6)
    assert found.summary.status == "no tolerance"


def test_a_device_that_stood_elsewhere_is_put_back_and_that_is_said(measured):
    """Fails if a new station makes a sound robot bad, a small shift is taken for a new station, or what it cost is kept back."""
    rows = pd.read_csv(measured / "new.csv")
    here = validate(measured / "runs", measured / "new.csv")
    turn = Rotation.from_euler("XYZ", [20.0, -10.0, 130.0], degrees=True)
    elsewhere = rows.assign(**dict(zip(X, (turn.apply(rows[X]) + np.array([4000.0, 100.0, 30.0])).T, strict=True)))
    measured.measure(elsewhere, "elsewhere.csv")
    found = validate(measured / "runs", measured / "elsewhere.csv")
    assert (found.summary.station, found.summary.frames, found.summary.freedom_lost) == ("fitted", 1, 6)
    assert found.judged.mean_mm == pytest.approx(here.judged.mean_mm, rel=0.5)
    assert found.judged.further_mm > found.judged.mean_mm
    assert found.of("nominal").mean_mm > 0.1
    measured.measure(rows.assign(x_mm=rows["x_mm"] + 0.5), "bumped.csv")
    bumped = validate(measured / "runs", measured / "bumped.csv", tolerance=0.3e-3)
    assert (bumped.summary.station, bumped.summary.status) == ("known", "not met")
    assert bumped.summary.moved_p < 1e-6
    assert any("--station fitted" in note for note in bumped.summary.notes)
    known = validate(measured / "runs", measured / "elsewhere.csv", station="known")
    assert known.judged.mean_mm > 1000


def test_rows_of_another_robot_are_asked_about(measured):
    """Fails if nothing asks for the robot where no frame brings the points as near as any calibrated robot's are."""
    rows = pd.read_csv(measured / "new.csv")
    measured.measure(rows.assign(q2_deg=-rows["q2_deg"].to_numpy()[::-1]), "other.csv")
    notes = validate(measured / "runs", measured / "other.csv").summary.notes
    assert any("more than any calibrated robot: are these rows of the robot" in note for note in notes)
    sound = validate(measured / "runs", measured / "new.csv").summary.notes
    assert not any("are these rows" in note for note in sound)


def test_points_nearly_on_a_line_do_not_make_a_device_stand_elsewhere(measured):
    """Fails if the turn about a line, of which such points tell nothing, has a bad robot's errors fitted away."""
    rows = pd.DataFrame({"pose": np.arange(1, 9), "payload": "light", "marker": "tool", "q1_deg": np.linspace(0, 4, 8)})
    measured.measure(rows.assign(q2_deg=-30.0, q3_deg=60.0), "asked.csv")
    seen = predict(measured / "runs", measured / "asked.csv")
    error = 0.3 * np.random.default_rng(1).standard_normal((8, 3))
    measured.measure(
        rows.assign(q2_deg=-30.0, q3_deg=60.0, **dict(zip(X, (seen[X] + error).to_numpy().T, strict=True))), "arc.csv"
    )
    found = validate(measured / "runs", measured / "arc.csv")
    assert found.summary.turned_mrad > 20  # about the line
    assert found.summary.station == "known"
    assert found.judged.mean_mm == pytest.approx(np.linalg.norm(error, axis=1).mean(), rel=1e-6)


def test_how_far_a_frame_moved_is_told_at_its_own_points(measured):
    """Fails if a session's frame is held against another session's points."""
    rows = pd.read_csv(measured / "new.csv")
    second = rows["pose"] > 6
    turn = Rotation.from_euler("z", 170, degrees=True)
    there = turn.apply(rows.loc[second, X]) + np.array([9000.0, 0.0, 0.0])
    rows.loc[second, X] = there
    measured.measure(rows.assign(session=np.where(second, "b", "a")), "two.csv")
    found = validate(measured / "runs", measured / "two.csv", station="fitted")
    back = turn.inv().apply(there - np.array([9000.0, 0.0, 0.0]))
    points = pd.DataFrame(there).groupby(rows["pose"][second].to_numpy()).mean().to_numpy()
    were = pd.DataFrame(back).groupby(rows["pose"][second].to_numpy()).mean().to_numpy()
    assert found.summary.moved_mm == pytest.approx(np.linalg.norm(points - were, axis=1).mean(), rel=1e-3)


def test_commands_are_judged_by_their_targets(measured):
    """Fails if a robot that was told where to go is judged by where the model says that it is."""
    rows = pd.read_csv(measured / "new.csv")
    targets = {f"target_{axis}_mm": rows[f"{axis}_mm"].round(0) for axis in "xyz"}
    measured.measure(rows.assign(**targets), "commanded.csv")
    found = validate(measured / "runs", measured / "commanded.csv", tolerance=2e-3)
    error = rows[X].groupby(rows["pose"]).mean() - rows[X].round(0).groupby(rows["pose"]).mean()
    assert found.summary.judged == "commanded"
    assert found.judged.mean_mm == pytest.approx(np.linalg.norm(error, axis=1).mean(), abs=1e-9)


def test_a_run_s_own_files_are_not_written_over(measured):
    """Fails if --out may be the run folder or one of its stages', whose tables of the same names would be gone."""
    before = measured.results()
    for out in ("runs", "runs/identify"):
        (told,) = measured.refused("validate", measured / "runs", measured / "new.csv", "--out", measured / out)
        assert "would be written over" in told
    assert measured.results() == before


def test_a_wild_pose_does_not_agree_with_what_was_promised(measured):
    """Fails if one pose that is off by 20 mm makes any promise agree, since it widens the interval of the mean."""
    rows = pd.read_csv(measured / "new.csv")
    assert "agrees" in measured.calflow("validate", measured / "runs", measured / "new.csv").out
    measured.measure(rows.assign(x_mm=rows["x_mm"] + 20.0 * (rows["pose"] == 3)), "wild.csv")
    wild = measured.calflow("validate", measured / "runs", measured / "wild.csv")
    assert "more than chance allows" in wild.out
    assert "agrees" not in wild.out


def test_a_load_that_is_not_stated_is_no_verdict(measured):
    """Fails if rows without the column `payload` are judged as if nothing had been carried, by millimetres of compliance."""
    rows = pd.read_csv(measured / "new.csv")
    measured.measure(rows.drop(columns="payload"), "bare.csv")
    for command in ("validate", "drift"):
        (told,) = measured.refused(command, measured / "runs", measured / "bare.csv")
        assert told.startswith('payload: expected light, heavy or "" for nothing')
    measured.measure(rows.assign(payload=""), "empty.csv")
    assert measured.calflow("validate", measured / "runs", measured / "empty.csv").code == 0


def test_a_target_has_three_coordinates(measured):
    """Fails if targets with an axis alone end in a traceback."""
    rows = pd.read_csv(measured / "new.csv")
    measured.measure(rows.assign(target_y_mm=rows["y_mm"]), "half.csv")
    (told,) = measured.refused("validate", measured / "runs", measured / "half.csv")
    assert told == "half.csv:1: missing column: expected target_x, target_z beside target_y"


def test_what_cannot_be_asked_is_refused(measured):
    """Fails if nonsense gives a verdict, or a frame is fitted to three poses."""
    rows = pd.read_csv(measured / "new.csv")
    measured.measure(rows[rows["pose"] <= 3], "few.csv")
    (told,) = measured.refused("validate", measured / "runs", measured / "few.csv", "--station", "fitted")
    assert "the device's frame cannot be fitted" in told
    (told,) = measured.refused("validate", measured / "runs", measured / "new.csv", "--tolerance-mm", -1)
    assert "--tolerance-mm: expected more than 0" in told
    (told, *_) = measured.refused("validate", measured / "runs", measured / "asked.csv")
    assert "asked.csv" in told
    assert not (measured / "runs" / "validate").exists()
