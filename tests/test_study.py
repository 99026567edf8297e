"""Studies: files found, settings of workflow and study together, and the rows that no fit may see."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

import calflow
from calflow.files.problems import InputError, Problem, nearest, run_checks
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.stages.catalogue import STAGES
from calflow.study import find_workflow, load_study, workflow_folder


def settings(folder, stage):
    return load_study(folder.path).validated_settings(stage, STAGES[stage].settings)


def test_a_study_is_given_by_its_folder_or_its_file(small):
    """Fails if one of the two is refused, or another workflow or robot is read than the study names."""
    by_folder, by_file = load_study(small.path), calflow.load_study(str(small / "study.toml"))
    assert by_folder == by_file
    assert (by_folder.name, by_folder.workflow.name, by_folder.robot.name) == ("small", "quick", "small")


def test_the_studys_settings_overrule_the_workflows(small):
    """Fails if a workflow's setting wins, is lost, or the same quantity in another unit is taken for a second one."""
    small.edit("quick.toml", ("candidates = 100", "candidates = 100\nsigma_mm = 0.07\nposes = 5"))
    assert (settings(small, "select").sigma, settings(small, "select").poses) == (pytest.approx(7e-5), 8)
    small.edit("study.toml", ("poses = 8", "sigma_um = 30"))
    found = settings(small, "select")
    assert (found.sigma, found.poses, found.candidates) == (pytest.approx(3e-5), 5, 100)
    assert load_study(small.path).settings("select") == {"sigma_um": 30, "poses": 5, "candidates": 100}


def test_what_goes_together_may_stand_in_both_files(small):
    """Fails if a region is refused whose lower corner stands in the workflow and whose upper one in the study."""
    small.edit("quick.toml", ("candidates = 100", "candidates = 100\nregion_min_mm = [0, 0, 0]"))
    small.edit("study.toml", ("poses = 8", "region_max_m = [1, 1, 1]"))
    assert settings(small, "select").region_max == (1.0, 1.0, 1.0)


def test_every_workflow_of_calflow_can_be_named(small):
    """Fails if a shipped workflow has a stage or a setting that does not exist."""
    for path in workflow_folder().glob("*.toml"):
        assert find_workflow(path.stem, small / "study.toml") == path
        small.edit("study.toml", (f'workflow = "{load_study(small.path).file.workflow}"', f'workflow = "{path.stem}"'))
        assert small.calflow("check").code == 0


def test_compliance_without_masses_is_refused_before_any_stage(small):
    """Fails if joint compliance is fitted with torques of massless links, or not all joints without a mass are named at once."""
    robot = (small / "robot.toml").read_text()
    small.edit("robot.toml", ("mass_kg = 30\ncom_mm = [350", "com_mm = [350"))
    for command in ("check", "run", "plan"):
        (told,) = small.refused(command)
        assert told.startswith(
            "robot.toml:11: joints[2]: effect 'joint-compliance' needs mass_kg and com_mm of every joint's"
        )
        assert "missing: joint 2 (" in told
    joints, others = robot.split("[payloads", 1)
    (small / "robot.toml").write_text(re.sub("(?m)^(mass_kg|com_mm).*\n", "", joints) + "[payloads" + others)
    (told,) = small.refused("check")
    assert "missing: joint 1, joint 2" in told
    small.edit("study.toml", ('["geometry", "joint-compliance"]', '["geometry"]'))
    assert small.calflow("check").code == 0


@pytest.mark.parametrize(("held", "told"), [(40, "holds 0 poses to fit"), (39, "holds 1 pose to fit and")])
def test_too_few_poses_to_fit_are_refused(small, held, told):
    """Fails if a fit is tried without data to fit."""
    rows = small.rows
    small.measure(rows.assign(split=np.where(rows["pose"].astype(int) <= held, "holdout", "train")))
    (problem,) = small.refused("check")
    assert told in problem


def test_all_that_is_missing_is_told_at_once(small):
    """Fails if a robot or measurements that are nowhere hide that others are, or what is wrong in the rows that are there."""
    lost = '[[measurements]]\nname = "one"\nfile = "one.csv"\n[[measurements]]\nname = "two"\nfile = "two.csv"\n[split]'
    small.edit("study.toml", ('[measurements]\nfile = "measurements.csv"', ""), ("[split]", lost))
    missing = [f"{name}.csv: no such measurement file" for name in ("one", "two")]
    assert [problem.split(";")[0] for problem in small.refused("check")] == missing
    (small / "two.csv").write_text("pose\n1\n")
    assert [problem.split(":")[0] for problem in small.refused("check")][:2] == ["one.csv", "two.csv"]
    (small / "two.csv").unlink()
    (small / "robot.toml").unlink()
    told = small.refused("check")
    assert [problem.split(";")[0] for problem in told] == ["robot.toml: no such file", *missing]


def test_wrong_keys_and_missing_files_are_told_at_once(small):
    """Fails if a file that a study names is looked for only once the study itself is free of mistakes."""
    small.edit(
        "study.toml",
        ("seed = ", "efects = []\nseed = -"),
        ('"robot.toml"', '"robbot.toml"'),
        ("holdout = ", "holdout = 2"),
    )
    told = [problem.split(": ")[1] for problem in small.refused("check")]
    assert told == ["efects", "seed", "split.holdout", "no such file, did you mean 'robot.toml'?"]


def drawn(small, seed=1, holdout=0.3, **columns):
    """The split of 60 poses of 2 rows, the first 40 with the light payload."""
    pose = np.repeat(np.arange(60), 2)
    table = pd.DataFrame({"pose": pose, "payload": np.where(pose < 40, "light", "heavy")} | columns)
    measured = Measurements(Robot.from_toml(small / "robot.toml"), table)
    return measured.split(holdout, seed).table


@pytest.mark.parametrize("holdout", [0, 0.3, 0.5])
def test_a_split_is_drawn_by_pose_with_each_payload_in_proportion(small, holdout):
    """Fails if rows of one pose are on both sides, a payload is held out more than another, or the share is wrong."""
    table = drawn(small, holdout=holdout)
    assert (table.groupby("pose")["split"].nunique() == 1).all()
    held = table.drop_duplicates("pose").groupby("payload")["split"].apply(lambda split: (split == "holdout").sum())
    assert held.to_dict() == {"light": 40 * holdout, "heavy": 20 * holdout}


def test_a_pose_measured_with_two_payloads_stays_whole(small):
    """Fails if such a pose is drawn once a payload, so that more is held out than was asked, or it is torn apart."""
    table = drawn(small, payload=["light", "heavy"] * 60)
    assert (table.groupby("pose")["split"].nunique() == 1).all()
    assert (table["split"] == "holdout").mean() == pytest.approx(0.3)


def test_each_session_is_held_out_in_proportion(small):
    """Fails if a session that a user states may be held out as a whole, or not at all."""
    session = np.repeat(np.where(np.arange(60) % 4 == 0, "monday", "tuesday"), 2)
    held = drawn(small, session=session, payload="light").drop_duplicates("pose").groupby("session")["split"]
    assert held.apply(lambda split: (split == "holdout").mean()).to_dict() == pytest.approx(
        {"monday": 0.3, "tuesday": 0.3}, abs=0.04
    )


def test_the_seed_decides_the_split(small):
    """Fails if a split changes from call to call, or with the order of the rows, or never."""
    first, again, other = drawn(small), drawn(small), drawn(small, seed=2)
    assert first["split"].equals(again["split"])
    assert not first["split"].equals(other["split"])
    backwards = Measurements(Robot.from_toml(small / "robot.toml"), first.drop(columns="split")[::-1])
    assert backwards.split(0.3, 1).table.sort_index()["split"].equals(first["split"])


def test_an_explicit_split_stays(small):
    """Fails if a user's own held-out poses are drawn anew."""
    mine = ["holdout"] * 6 + ["train"] * 114
    assert list(drawn(small, split=mine)["split"]) == mine


def test_problems_read_as_one_line_each():
    """Fails if a problem loses its place, or several checks do not add up."""
    assert str(Problem("wrong", None, None, "a.b")) == "a.b: wrong"

    def fail(*words):
        raise InputError(Problem(word) for word in words)

    with pytest.raises(InputError, match=r"^one\ntwo\nthree$"):
        run_checks(lambda: fail("one", "two"), lambda: 1, lambda: fail("three"))
    assert run_checks(lambda: 1, lambda: 2) == [1, 2]


@pytest.mark.parametrize(("word", "expected"), [("X_MM", "'x_mm'"), ("payloda", "'payload'"), ("zzz", None)])
def test_the_nearest_name_is_offered_only_where_there_is_one(word, expected):
    """Fails if case hides a name, or a far-fetched one is offered."""
    assert nearest(word, ["x_mm", "payload"]) == (f", did you mean {expected}?" if expected else "")


def test_a_folder_of_studies_names_them(small):
    """Fails if a folder that holds studies of other names is said to have none, or its other files are taken for studies."""
    for name in ("one", "two"):
        (small / f"{name}.toml").write_bytes((small / "study.toml").read_bytes())
    (small / "study.toml").unlink()
    with pytest.raises(InputError, match=r"study\.toml: no such file: expected \S*one\.toml or \S*two\.toml$"):
        load_study(small.path)
