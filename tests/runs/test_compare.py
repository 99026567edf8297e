"""Comparison of runs: chance is told from difference, and the same measurements from others."""

from __future__ import annotations

import pandas as pd
import pytest

from applied import compare
from calflow.files.problems import InputError


def again(folder, name, *changes):
    """Measure the robot once more, somewhat otherwise, and identify it into another run."""
    folder.edit("truth.toml", ("seed = 3", "seed = 5"), *changes)
    assert folder.calflow("simulate", folder / "truth.toml", "--out", folder / "measurements.csv", "--force").code == 0
    assert folder.calflow("run", "--stage", "identify", "--out", folder / name).code == 0


def test_another_robot_differs_and_the_same_one_does_not(finished):
    """Fails if two calibrations of one robot differ beyond chance, or a longer arm is not told by its name."""
    again(finished, "same")
    finished.edit("truth.toml", ("seed = 5", "seed = 3"))
    again(finished, "longer", ("a_mm = 0.5", "a_mm = 0.8"))
    found = compare(finished / "runs", finished / "same", finished / "longer")
    same, longer, _ = found.pairs
    assert same.p > 0.001
    assert longer.p < 1e-6
    beyond = {
        one.parameter for one in found.parameters if one.significant and one.second == "longer" and one.first == "runs"
    }
    assert "joint2.a" in beyond
    row = next(
        one for one in found.parameters if one.parameter == "joint2.a" and (one.first, one.second) == ("runs", "longer")
    )
    assert row.difference == pytest.approx(0.3e-3, abs=4 * row.sd)
    answer = finished.calflow("compare", finished / "runs", finished / "same", "--out", finished / "c")
    assert answer.code == 0
    assert "agree within what both leave open" in answer.out
    assert (finished / "c" / "report.pdf").read_bytes().startswith(b"%PDF")
    assert list(pd.read_csv(finished / "c" / "accuracy.csv")["run"].unique()) == ["runs", "same"]


def test_runs_of_different_robots_do_not_agree(finished):
    """Fails if parameters of two robots are said to agree before it is said that they are of two robots."""
    finished.edit("robot.toml", ('name = "small"', 'name = "other"'))
    again(finished, "other")
    answer = finished.calflow("compare", finished / "runs", finished / "other")
    assert answer.out.startswith("runs and other are of different robots, small and other. ")
    assert "agree" not in answer.out
    assert [pair.robot for pair in compare(finished / "runs", finished / "other").pairs] == ["another one"]
    finished.edit("robot.toml", ('name = "other"', 'name = "small"'), ("mass_kg = 60", "mass_kg = 61"))
    finished.edit("truth.toml", ("seed = 5", "seed = 3"))
    again(finished, "heavier")
    answer = finished.calflow("compare", finished / "runs", finished / "heavier")
    assert answer.out.startswith("runs and heavier have different robot files. ")


def test_the_same_measurements_have_no_test_of_chance(finished):
    """Fails if runs of the very same data are compared as if their errors were independent, or a changed setting is not told."""
    finished.edit("study.toml", ('"geometry", "joint-compliance"', '"geometry"'))
    assert finished.calflow("run", "--stage", "identify", "--out", finished / "stiff").code == 0
    found = compare(finished / "runs", finished / "stiff")
    assert found.pairs[0].p is None
    assert all(one.sd is None for one in found.parameters)
    assert found.data[0].same_data_as == ("stiff",)
    assert not found.notes
    assert "effects" in [one.setting for one in found.settings]
    with pytest.raises(InputError, match="expected two runs"):
        compare(finished / "runs")


def test_what_describes_the_robot_is_no_measurement(finished):
    """Fails if runs of one URDF count as of the same measurements, or files of one name as one file."""
    again(finished, "same")
    for run in ("runs", "same"):
        more = {"/robots/arm.urdf": "1" * 64, f"/other/{run}/measurements.csv": ("2" if run == "same" else "3") * 64}
        finished.vouch(lambda manifest, more=more: manifest["inputs"].update(more), run)
    found = compare(finished / "runs", finished / "same")
    assert found.pairs[0].p is not None
    assert found.data[0].files == ("measurements.csv", "measurements.csv")
    assert "robot file's content" not in [one.setting for one in found.settings]


def test_another_robot_is_told(finished):
    """Fails if runs of different robot files are compared without a word."""
    finished.edit("robot.toml", ("a_mm = 700", "a_mm = 701"))
    again(finished, "other")
    found = compare(finished / "runs", finished / "other")
    own = next(one for one in found.settings if one.setting == "robot file's content")
    assert len(set(own.of.values())) == 2
