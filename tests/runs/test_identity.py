"""Whose run a folder holds: a study is not run over another's results, and goes on wherever it is moved."""

from __future__ import annotations

import shutil

import pytest

from calflow.runs.planning import UNCHANGED
from conftest import Folder, in_process


@pytest.fixture
def namesake(finished, small, tmp_path):
    """Another study of the same name, in a folder elsewhere."""
    shutil.copytree(small.path, tmp_path / "other")
    return Folder(tmp_path / "other")


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("study.toml", "seed = 7", "seed = 8"),
        ("robot.toml", "a_mm = 100", "a_mm = 101"),
        ("measurements.csv", "light", "heavy"),
    ],
)
def test_another_study_of_the_same_name_is_refused(finished, namesake, name, old, new):
    """Fails if the results of one robot are overwritten with those of another whose study was copied."""
    namesake.edit(name, (old, new))
    before = finished.results()
    answer = namesake.calflow("run", "--out", finished / "runs")
    assert answer.code == 2
    for said in ("another study of the same name", str(namesake / "study.toml"), "--out"):
        assert said in answer.err
    assert finished.results() == before


def test_both_studies_are_named(finished, namesake):
    """Fails if the user is not told whose results are in danger."""
    assert finished.calflow("run", "--stage", "select", "--force").code == 0
    namesake.edit("study.toml", ("seed = 7", "seed = 8"))
    told = namesake.calflow("run", "--out", finished / "runs").err
    assert str(finished / "study.toml") in told
    assert str(namesake / "study.toml") in told


def test_a_copy_of_the_study_goes_on(finished, namesake):
    """Fails if a study that was moved or copied must run anew."""
    answer = namesake.calflow("run", "--out", finished / "runs")
    assert answer.code == 0
    assert answer.out.count(f"reused ({UNCHANGED})") == 3
    namesake.edit("study.toml", ("poses = 8", "poses = 9"))  # it is the run's own study now
    assert namesake.calflow("run", "--out", finished / "runs").code == 0


def test_a_study_that_moved_with_its_runs_may_change(finished, tmp_path):
    """Fails if a project folder that was copied as a whole cannot be edited."""
    assert finished.calflow("run").code == 0
    shutil.copytree(finished.path, tmp_path / "project")
    copy = Folder(tmp_path / "project")
    copy.edit("study.toml", ("poses = 8", "poses = 9"))
    assert copy.calflow("run").code == 0


def test_two_studies_of_one_folder_are_two(finished):
    """Fails if a second study file beside the first one takes its results."""
    text = (finished / "study.toml").read_text(encoding="utf-8").replace("seed = 7", "seed = 8")
    (finished / "second.toml").write_text(text, encoding="utf-8")
    answer = in_process("run", finished / "second.toml", "--out", finished / "runs")
    assert answer.code == 2
    assert str(finished / "second.toml") in answer.err
