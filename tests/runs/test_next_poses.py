"""The measuring loop as its user runs it: before anything is measured, after each batch, and where something is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calflow.stages.measuring_loop as loop
from calflow.design.planned import SelectionRequest
from calflow.model import build
from calflow.runs.given_rows import with_rows
from calflow.stages.measuring_loop import next_poses
from calflow.study import load_study
from conftest import in_process

STUDIES = Path(__file__).parents[2] / "studies"
CELL = """
[stages.select.cell]
floor_mm = 100
clearance_mm = 20

[[stages.select.cell.stations]]
origin_mm = [3000, 0, 1000]
elevation_max_deg = 10
"""
REGION = (
    'region_min_mm = [200, -1500, 200]\nregion_max_mm = [1500, 1500, 1200]\ntolerance_mm = 0.05\npayload = "heavy"\n'
)


def asked(small):
    """Give the study a region, a tolerance and a cell."""
    small.edit("study.toml", ("poses = 8\n", f"poses = 8\n{REGION}{CELL}"))


def on_first(small, poses):
    """Keep the rows of so many poses."""
    rows = small.rows
    small.measure(rows[rows["pose"].isin(rows["pose"].unique()[:poses])])
    return rows[~rows["pose"].isin(rows["pose"].unique()[:poses])]


def test_it_begins_without_measurements_and_goes_on_until_there_is_a_verdict(small):
    """Fails if a study whose file is not written yet is refused, or poses that cannot tell anything yet get a verdict."""
    asked(small)
    rows = small.rows
    (small / "measurements.csv").unlink()
    first = in_process("next", small.path, "--number", 7, "--out", small / "first")
    assert first.code == 4, first
    assert first.out.startswith("nothing measured yet")
    assert "measurements.csv is not there yet" in first.out
    poses = pd.read_csv(small / "first" / "poses.csv")
    assert list(poses["pose"]) == list(range(1, 8))
    assert set(poses["payload"]) == {"heavy"}
    small.measure(rows[rows["pose"].isin(rows["pose"].unique()[:6])])
    few = in_process("next", small.path)
    assert few.code == 4
    assert "6 poses: too few" in few.out
    assert "measure at least" in few.out


def test_the_verdict_and_the_poses_are_written_and_within_the_cell(small):
    """Fails if a pose leaves limits, region or cell, poses are numbered from 1 again, or the document is not what is said."""
    asked(small)
    answer = in_process("next", small.path, "--number", 6, "--tolerance-mm", 0.001, "--out", small / "next")
    assert answer.code == 4, answer
    poses, told = (
        pd.read_csv(small / "next" / "poses.csv"),
        json.loads((small / "next" / "verdict.json").read_text(encoding="utf-8")),
    )
    assert told["status"] == "measure"
    assert told["tolerance_mm"] == pytest.approx(0.001)
    assert told["probability"] < 0.05
    assert told["error_mm"] > 0.001
    assert poses["pose"].min() == small.rows["pose"].astype(int).max() + 1
    assert poses["reason"].str.len().min() > 5
    study = load_study(small.path)
    cell = study.validated_settings("select", loop.SelectSettings).cell
    model = build(study.robot, ("geometry",), (), ())
    q = np.deg2rad(poses[["q1_deg", "q2_deg", "q3_deg"]].to_numpy())
    region = np.array([[0.2, -1.5, 0.2], [1.5, 1.5, 1.2]]) + np.array([[-5e-3], [5e-3]])  # the base is fitted
    assert SelectionRequest(payload="heavy", marker="tool", region=region, cell=cell).allowed(model, q).all()


def test_rows_given_besides_count_as_if_they_stood_in_the_file(small):
    """Fails if a batch in a file of its own is dropped, or its poses are taken for others of the same name."""
    asked(small)
    whole = next_poses(load_study(small.path), 3).verdict
    small.measure(on_first(small, 25), "batch.csv")
    parts = next_poses(with_rows(load_study(small.path), (small / "batch.csv",)), 3).verdict
    assert (parts.poses, parts.fitted_poses) == (whole.poses, whole.fitted_poses)
    assert parts.probability == pytest.approx(whole.probability, abs=0.05)
    assert parts.error_mm == pytest.approx(whole.error_mm, rel=0.2)


def test_the_same_measurements_give_the_same_answer_and_leave_the_run_alone(finished):
    """Fails if an answer depends on chance that no seed tells, or anything of a run changes."""
    before = finished.results()
    for folder in ("one", "two"):
        assert in_process("next", finished.path, "--tolerance-mm", 0.001, "--out", finished / folder).code == 4
    assert (finished / "one" / "poses.csv").read_bytes() == (finished / "two" / "poses.csv").read_bytes()
    assert (finished / "one" / "verdict.json").read_bytes() == (finished / "two" / "verdict.json").read_bytes()
    assert finished.results() == before
    answer = in_process("next", finished.path, "--out", finished / "runs")
    assert answer.code == 2
    assert "give another folder with --out" in answer.err


def test_interrupted_it_leaves_nothing(small, monkeypatch):
    """Fails if a folder is there before all is known."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("calflow.design.next_poses.further_poses", interrupted)
    answer = in_process("next", small.path, "--tolerance-mm", 0.001, "--out", small / "next")
    assert answer.code == 130
    assert not (small / "next").exists()


@pytest.mark.parametrize(
    ("edit", "options", "said"),
    [
        ("", ("--number", 0), "number: expected a number greater than or equal to 1, found 0"),
        ("", ("--probability", 1), "--probability: expected a number less than 1, found 1"),
        ("", ("--tolerance-mm", -1), "expected a tolerance above 0, found -1"),
        ("", ("--rows", "nowhere.csv"), "no such file"),
        ('payload = "havy"\n', (), "unknown payload 'havy'"),
        ("region_min_m = [90, 90, 90]\nregion_max_m = [91, 91, 91]\n", (), "is the region"),
    ],
)
def test_what_is_wrong_is_said(small, edit, options, said):
    """Fails if a mistake ends with a traceback, or is not named."""
    small.edit("study.toml", ("poses = 8\n", f"poses = 8\n{edit}"))
    answer = in_process("next", small.path, *options)
    assert answer.code == 2, answer
    assert said in answer.err


def test_the_settings_are_read_from_where_select_reads_them(small):
    """Fails if the tolerance of the study counts for nothing, or the worst point is asked for and not compared."""
    asked(small)
    small.edit("study.toml", ("poses = 8\n", 'poses = 8\ncriterion = "worst"\n'))
    worst = next_poses(load_study(small.path), 2).verdict
    small.edit("study.toml", ('criterion = "worst"', 'criterion = "tool"'))
    rms = next_poses(load_study(small.path), 2).verdict
    assert (worst.measure, rms.measure) == ("worst", "rms")
    assert worst.tolerance_mm == pytest.approx(0.05)
    assert worst.error_mm > 1.2 * rms.error_mm
