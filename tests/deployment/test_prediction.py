"""Prediction: the identified robot's positions and how sure they are, and no others."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from applied import predict
from calflow.deployment.compensation import compensate
from calflow.deployment.prediction import predict_rows
from calflow.effects.thermal_growth import ThermalGrowth
from calflow.estimation.model_tables import calibrated
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.run_folder import read_manifest, read_results

X, SD = ["x_mm", "y_mm", "z_mm"], ["sd_x_mm", "sd_y_mm", "sd_z_mm"]


@pytest.fixture
def asked(finished):
    """The measured rows without what was measured."""
    finished.measure(finished.rows.drop(columns=[*X, "sigma_mm"]), "asked.csv")
    return finished / "asked.csv"


def fitted(finished) -> np.ndarray:
    """Which rows were fitted: held-out ones are predicted like any other."""
    return (pd.read_csv(finished / "runs" / "identify" / "residuals.csv")["split"] == "train").to_numpy()


def test_it_predicts_what_identify_predicts(finished, asked):
    """Fails if another model, payload or base is used than the one identified: residuals must add up to the millimetre's 1e-6."""
    predicted = predict(finished / "runs", asked)
    residuals = pd.read_csv(finished / "runs" / "identify" / "residuals.csv")
    measured = finished.rows[X].astype(float).to_numpy()
    np.testing.assert_allclose(predicted[X], measured + residuals[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(), atol=1e-6)
    assert list(predicted.columns) == [*pd.read_csv(asked).columns, *X, *SD]
    np.testing.assert_array_equal(predicted["q1_deg"], pd.read_csv(asked)["q1_deg"])


def test_its_standard_deviations_are_those_of_the_covariance(finished, asked):
    """Fails if sd is not the root of the diagonal of J C Jᵀ, here with J by central differences, and of what smooth errors add."""
    predicted = predict(finished / "runs", asked)
    results = read_results(read_manifest(finished / "runs"), finished / "runs", "identify")
    robot = Robot.from_toml(finished / "robot.toml")
    data = Measurements.to_predict(asked, robot)
    known = calibrated(robot, results, data.given)
    covariance = results.tables["identify/covariance.csv"].drop(columns="parameter").to_numpy()
    step = 1e-3 * known.model.prior_sd
    jacobian = np.stack(
        [
            (
                known.model.position(known.estimate + h, data.conditions)
                - known.model.position(known.estimate - h, data.conditions)
            )
            / (2 * s)
            for h, s in zip(np.diag(step), step, strict=True)
        ],
        axis=2,
    )
    moved = known.errors.moved(known.model, known.estimate, data.conditions)
    both = np.concatenate([jacobian, moved], axis=2) @ known.errors.root(known.errors.about_mean(covariance))
    alone = moved @ known.errors.spread
    variance = known.errors.rest[METRE] ** 2 + (both**2).sum(axis=2) + (alone**2).sum(axis=2)
    np.testing.assert_allclose(predicted[SD], 1e3 * np.sqrt(variance), rtol=1e-4)


def test_readings_beyond_the_measured_range_are_told(finished, asked):
    """Fails if a joint far from where it was measured is predicted without a word, or one that was there is named."""
    rows = pd.read_csv(asked, dtype=str).drop(columns="pose")
    low, high = rows["q1_deg"][fitted(finished)].astype(float).agg(["min", "max"])
    rows["q1_deg"] = [
        str(high + 0.09 * (high - low)),
        str(high + 0.11 * (high - low)),
        *([str((low + high) / 2)] * (len(rows) - 2)),
    ]
    finished.measure(rows, "asked.csv")
    answer = finished.calflow("predict", finished / "runs", asked, "--out", finished / "p.csv")
    assert "joint 1 is beyond its measured range in line 3: " in answer.err
    assert answer.err.count("beyond its measured range") == 1


def test_commands_beyond_the_measured_range_are_told(finished, asked):
    """Fails if a target is reached by a joint that was never measured there, without a word."""
    results = read_results(read_manifest(finished / "runs"), finished / "runs", "identify")
    robot = Robot.from_toml(finished / "robot.toml")
    data = Measurements.to_predict(asked, robot)
    known = calibrated(robot, results, data.given)
    joints = data.joints[fitted(finished)]
    travel = np.array([joints.min(axis=0), joints.max(axis=0)])
    np.testing.assert_allclose(known.joint_range, travel, atol=1e-9)
    few = data.only(np.arange(len(data)) < 4)
    farthest = int(np.argmax(few.joints[:, 0]))
    travel[:, 0] = few.joints[farthest, 0] - np.array([0.2, 0.1])
    sent = compensate(
        replace(known, joint_range=travel),
        predict_rows(known, few).position,
        start=few.joints,
        payload=list(few.table["payload"]),
    )
    (note,) = (note for note in sent.notes if "measured range" in note)
    assert str(farthest) in note.split("pose ")[1]


def test_time_counts_from_where_the_fit_s_did(small, monkeypatch):
    """Fails if a warm-up is predicted as if the first row asked for stood at the start of the measurements."""
    monkeypatch.setattr(
        ThermalGrowth.__init__, "__defaults__", (1800.0, (), np.inf, False)
    )  # by time, not by temperature
    small.measure(small.rows.assign(time_s=[5e8 + 60.0 * i for i in range(80)]))
    small.edit("study.toml", ('"joint-compliance"', '"thermal-growth"'))
    small.edit("quick.toml", ('"identify", "sample"', '"identify"'))
    rows = small.rows
    warm = 1 + 1e-3 * (1 - np.exp(-60.0 * np.arange(80) / 1800.0))
    small.measure(rows.assign(**{name: rows[name].astype(float) * warm for name in X}))
    assert small.calflow("run").code == 0
    summary = json.loads((small / "runs" / "identify" / "summary.json").read_text(encoding="utf-8"))
    assert float(summary["time_origin_s"]) == 5e8
    asked = small.rows[60:].drop(columns=[*X, "sigma_mm"])
    small.measure(asked, "asked.csv")
    predicted = predict(small / "runs", small / "asked.csv")
    residuals = pd.read_csv(small / "runs" / "identify" / "residuals.csv")[60:]
    expected = small.rows[X].astype(float).to_numpy()[60:] + residuals[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()
    np.testing.assert_allclose(predicted[X], expected, atol=1e-6)
    assert list(predicted["time_s"]) == [5e8 + 60.0 * i for i in range(60, 80)]


def test_rows_keep_their_order_columns_and_names(finished):
    """Fails if empty lines shift predictions, optional columns are needed or unknown text is rewritten."""
    text = "q3_deg,q1_deg,q2_rad,payload\n10,20,-0.5,heavy\n\n,,,\n30,40,-1,\n"
    (finished / "few.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    table = predict(finished / "runs", finished / "few.csv")
    assert list(table.columns[:4]) == ["q3_deg", "q1_deg", "q2_rad", "payload"]
    assert table["payload"].tolist() == ["heavy", ""]
    swapped = table.iloc[::-1, :4]
    finished.measure(swapped, "swapped.csv")
    np.testing.assert_allclose(predict(finished / "runs", finished / "swapped.csv")[X], table[X][::-1], rtol=1e-12)


def test_it_needs_the_run_folder_alone(finished, asked, tmp_path):
    """Fails if a run folder that was sent to somebody else cannot predict."""
    here = predict(finished / "runs", asked)
    shutil.copytree(finished / "runs", tmp_path / "sent")
    shutil.copy(asked, tmp_path / "asked.csv")
    shutil.rmtree(finished.path)
    pd.testing.assert_frame_equal(predict(tmp_path / "sent", tmp_path / "asked.csv"), here)


def test_the_command_prints_or_writes_the_same_table(finished, asked):
    """Fails if the printed table is cut or rounded otherwise than the written one."""
    printed = finished.calflow("predict", finished / "runs", asked)
    written = finished.calflow("predict", finished / "runs", asked, "--out", finished / "new" / "p.csv")
    assert (printed.code, written.code) == (0, 0)
    assert printed.out == (finished / "new" / "p.csv").read_text(encoding="utf-8")


def test_rows_are_read_and_answered_as_the_studys_data_are(finished, asked):
    """Fails if a table of the study's own spreadsheet, with ';' and decimal commas, is misread, or answered otherwise."""
    plain = predict(finished / "runs", asked)
    rows = finished.rows
    rows.to_csv(finished / "measurements.csv", sep=";", index=False)
    text = (finished / "measurements.csv").read_text(encoding="utf-8").replace(".", ",")
    (finished / "measurements.csv").write_text(text, encoding="utf-8")
    finished.edit(
        "study.toml", ('file = "measurements.csv"', 'file = "measurements.csv"\nseparator = ";"\ndecimal = ","')
    )
    assert finished.calflow("run", "--stage", "identify").code == 0
    pd.read_csv(asked, dtype=str, keep_default_na=False).to_csv(asked, sep=";", index=False)
    asked.write_text(asked.read_text(encoding="utf-8").replace(".", ","), encoding="utf-8")
    answer = finished.calflow("predict", finished / "runs", asked)
    pd.testing.assert_frame_equal(pd.read_csv(io.StringIO(answer.out), sep=";", decimal=","), plain)


ROWS = {
    "no such file": (None, ["asked.csv: no such file"]),
    "a column short": ("q1_deg,q2_deg,payload\n1,2,\n", ["asked.csv:1: missing column: expected q3_rad or q3_deg"]),
    "measured positions": (
        "q1_deg,q2_deg,q3_deg,payload,x_mm\n1,2,3,,4\n",
        ["asked.csv:1: column 'x_mm' is what will be predicted"],
    ),
    "unknown column": (
        "q1_deg,q2_deg,q3_deg,payload,payloda\n1,2,3,,4\n",
        ["asked.csv:1: unknown column 'payloda', did you mean 'payload'?"],
    ),
    "unknown payload": ("q1_deg,q2_deg,q3_deg,payload\n1,2,3,havy\n", ["asked.csv:2: unknown payload 'havy'"]),
    "empty cell": ("q1_deg,q2_deg,q3_deg,payload\n1,2,3,\n1,,3,\n", ["asked.csv:3: column 'q2_deg' is empty"]),
    "degrees in _rad": ("q1_rad,q2_rad,q3_rad,payload\n100,20,30,\n", ["does a column named _rad hold degrees?"]),
    "header only": ("q1_deg,q2_deg,q3_deg,payload\n", ["is empty"]),
}


@pytest.mark.parametrize(("text", "expected"), ROWS.values(), ids=ROWS)
def test_wrong_rows_are_refused(finished, text, expected):
    """Fails if a prediction is made for rows that say something else or nothing."""
    if text is not None:
        (finished / "asked.csv").write_text(text, encoding="utf-8")
    told = finished.refused("predict", finished / "runs", finished / "asked.csv", "--out", finished / "p.csv")
    assert len(told) == len(expected), told
    assert expected[0] in told[0]
    assert not (finished / "p.csv").exists()


def test_what_is_assumed_of_the_rows_is_said(finished):
    """Fails if rows that do not say what is carried are predicted for an empty hand, or a note spoils the table."""
    (finished / "few.csv").write_text("q1_deg,q2_deg,q3_deg\n10,-20,30\n", encoding="utf-8")
    (told,) = finished.refused("predict", finished / "runs", finished / "few.csv")
    assert told.startswith('payload: expected light, heavy or "" for nothing')
    (finished / "few.csv").write_text("q1_deg,q2_deg,q3_deg,payload\n10,-20,30,\n", encoding="utf-8")
    answer = finished.calflow("predict", finished / "runs", finished / "few.csv")
    assert "note: no column 'pose'" in answer.err
    assert answer.out.startswith("q1_deg,")


def no_run(finished):
    shutil.rmtree(finished / "runs")


def select_alone(finished):
    no_run(finished)
    assert finished.calflow("run", "--stage", "select").code == 0


def test_a_run_that_is_not_there_is_not_said_to_be_empty(finished):
    """Fails if a misspelt run folder is taken for one without a run, or the one that was meant is not named."""
    (told,) = finished.refused("predict", finished / "rusn", finished / "measurements.csv")
    assert told.endswith(
        "no such folder: expected a folder that 'calflow run' has filled, or a study, did you mean 'runs'?"
    )


def another_robot(finished):
    finished.edit("robot.toml", ("a_mm = 100", "a_mm = 101"))
    assert finished.calflow("run", "--stage", "select").code == 0


def failed_since(finished):
    finished.measure(finished.rows[:12])
    assert finished.calflow("run").code == 2


def by_hand(finished):
    path = finished / "runs" / "identify" / "parameters.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("joint2.a,", "joint2.b,"), encoding="utf-8")


def lost(finished):
    (finished / "runs" / "identify" / "covariance.csv").unlink()


@pytest.mark.parametrize(
    ("happened", "expected"),
    [
        (no_run, "no such folder: expected a folder that 'calflow run' has filled"),
        (select_alone, "holds no identified robot: identify was never run"),
        (another_robot, "holds no identified robot: the robot file changed after identify ran"),
        (failed_since, "holds no identified robot: identify did not finish (failed)"),
        (by_hand, "identify/parameters.csv was changed by hand"),
        (lost, "identify/covariance.csv is missing"),
    ],
)
def test_a_run_that_does_not_hold_is_refused(finished, asked, happened, expected):
    """Fails if old results are mixed with a new robot, or edited or half a run's results are used."""
    happened(finished)
    (told,) = finished.refused("predict", finished / "runs", asked)
    assert expected in told
