"""The history of a robot: what moved between its runs is named with its time, and runs that cannot tell are refused."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from applied import history
from calflow.calibration import Calibration
from calflow.commands.console import exit_code
from calflow.deployment.history import history as deployed
from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.effects.joint_eccentricity import JointEccentricity
from calflow.reporting.history_report import history_lines
from calflow.runs.between_runs import _refitted, compare_runs, history_of_runs
from conftest import without_data


@pytest.fixture(scope="module")
def _measured_twice_more(_finished, tmp_path_factory):
    """The finished study, measured and identified twice more."""
    finished = _finished.copied(tmp_path_factory.mktemp("history") / "finished")
    shutil.copy(finished / "measurements.csv", finished / "runs.csv")
    for seed, name, change in ((5, "second", "0.5"), (6, "third", "0.8")):
        text = (finished / "truth.toml").read_text(encoding="utf-8")
        text = text.replace("seed = 3", f"seed = {seed}").replace("a_mm = 0.5", f"a_mm = {change}")
        (finished / "other.toml").write_text(text, encoding="utf-8")
        measured = finished / "measurements.csv"
        assert finished.calflow("simulate", finished / "other.toml", "--out", measured, "--force").code == 0
        with without_data():
            assert finished.calflow("run", "--stage", "identify", "--out", finished / name).code == 0
        shutil.copy(measured, finished / f"{name}.csv")
    return finished


@pytest.fixture
def three(_measured_twice_more, finished):
    """Three runs, of one robot whose second link's length is 0.3 mm more from the third on."""
    _measured_twice_more.copied(finished.path)
    return [finished / name for name in ("runs", "second", "third")]


def test_what_moved_is_named_with_its_time_and_size(finished, three):
    """Fails if the longer link is missed, another one is said to have moved, or tables, report and exit code tell otherwise."""
    answer = finished.calflow("history", *three, "--out", finished / "h")
    assert answer.code == 3, answer
    assert "joint2.a) moved between second and third by 0." in answer.out
    (moved,) = pd.read_csv(finished / "h" / "moved.csv").to_dict("records")
    assert (moved["parameter"], moved["after"], moved["before"]) == ("joint2.a", "second", "third")
    assert moved["shift"] == pytest.approx(0.3e-3, abs=4 * moved["sd"])
    present = pd.read_csv(finished / "h" / "present.csv").set_index("parameter")
    assert list(present.index[present["recalibrate"]]) == ["joint2.a"]
    assert (present["runs"].drop("joint2.a") == 3).all()
    assert list(pd.read_csv(finished / "h" / "runs.csv")["moved"]) == [False, False, True]
    assert (finished / "h" / "report.pdf").read_bytes().startswith(b"%PDF")


def test_a_robot_that_stayed_is_in_place(finished, three):
    """Fails if noise passes for a change."""
    answer = finished.calflow("history", *three[:2])
    assert answer.code == 0
    assert answer.out.startswith("Nothing has moved")
    assert not history(*three[:2]).moved


def test_runs_that_tell_nothing_of_time_are_refused_together(finished, three):
    """Fails if the same measurements, another robot or an order against the dates passes for a history."""
    (told,) = finished.refused("history", three[0])
    assert told.startswith("runs: expected two runs or more")
    (told,) = finished.refused("history", *three, "--false-alarm", 0)
    assert told.startswith("--false-alarm: ")
    finished.edit("robot.toml", ('name = "small"', 'name = "other"'))
    finished.edit("study.toml", ("[split]", "[acceptance]\ndate = 2025-01-02\n\n[split]"))
    assert finished.calflow("run", "--stage", "identify", "--out", finished / "other").code == 0
    same, robot = finished.refused("history", *three, finished / "other")
    assert same.startswith("other: is of the same measurements as third")
    assert robot.startswith("other: is of another robot than runs")


def test_what_only_the_prior_tells_apart_does_not_move(finished):
    """Fails if taking the priors out makes figures that nobody measured fly apart between two runs that are alike."""
    run = Calibration.load(finished / "runs")
    still = deployed(["first", "copy"], [None, None], [run, run], 0.01, np.random.default_rng(1))
    assert not still.moved
    assert [row.told for row in still.parameters].count(False) > 0


def loaded(finished, name: str) -> Calibration:
    """A run, with its measurements read: the next one's were written over them."""
    shutil.copy(finished / f"{name}.csv", finished / "measurements.csv")
    with without_data():
        run = Calibration.load(finished / name)
        assert len(run.data)
    return run


def with_cause(run: Calibration, effect: type[Effect], part: str) -> Calibration:
    """A run whose diagnosis found a cause."""
    robot = run.model.robot
    found = _refitted(run, [Cause(robot, effect(robot), part)])
    assert isinstance(found, Calibration)
    return found


def test_runs_with_other_causes_are_compared_with_those_of_all(finished, three):
    """Fails if a joint is left out because one run's diagnosis found a cause there, or its figures mean another thing in each."""
    first, second, third = (loaded(finished, run.name) for run in three)
    second = with_cause(second, JointEccentricity, "joint2")
    alike = history_of_runs(first, second)
    assert {"joint2.a", "joint2.theta"} <= {row.parameter for row in alike.parameters}
    assert "with the causes of all runs (eccentricity of joint 2), " in alike.notes[0]
    assert alike.status == "in place"
    beside = compare_runs(first, second)
    assert (beside.notes, "joint2.theta" in {row.parameter for row in beside.parameters}) == (alike.notes[:1], True)
    later = history_of_runs(first, second, third)
    assert [(moved.parameter, moved.after, moved.before) for moved in later.moved] == [("joint2.a", "second", "third")]


def test_runs_whose_measurements_are_gone_are_compared_as_they_are(finished, three):
    """Fails if a run that cannot be fitted again is refused, or passes for one that has the causes of all."""
    first = with_cause(loaded(finished, three[0].name), JointEccentricity, "joint2")
    with without_data():  # where the second's were, others are
        told = history_of_runs(first, Calibration.load(three[1]))
    assert "second cannot be fitted again" in told.notes[0]
    assert "joint2.a" not in {row.parameter for row in told.parameters}


def test_what_only_one_change_explains_is_named(finished):
    """Fails if a zero that moved is not named, with its size, where each parameter's own estimate is too unsure to tell."""
    run = Calibration.load(finished / "runs")
    names = [parameter.name for parameter in run.model.parameters]
    moved = np.zeros(len(names))
    moved[names.index("joint3.theta")] = 1e-3
    shown = moved - run.covariance @ (moved / run.model.prior_sd**2)
    still = np.random.default_rng(2)
    told = deployed(["a", "b"], [None, None], [run, replace(run, estimate=run.estimate + shown)], 0.01, still)
    (lone,) = told.lone
    assert (lone.parameter, lone.after, lone.before) == ("joint3.theta", "a", "b")
    assert lone.shift == pytest.approx(1e-3, rel=1e-6)
    assert lone.probability > 0.99
    assert lone.left_p == pytest.approx(1.0)
    alone = replace(told, moved=())
    assert (alone.status, alone.named, alone.nameless) == ("moved", (lone,), ())
    unsure = replace(alone, lone=(replace(lone, probability=0.6),))
    assert (unsure.status, unsure.named, len(unsure.nameless)) == ("cannot be told", (), 1)


def test_runs_that_could_show_nothing_are_not_said_to_be_in_place(finished):
    """Fails if a robot is said to have stayed by calibrations that know no more than was known before."""
    run = Calibration.load(finished / "runs")
    blind = replace(run, covariance=np.diag(run.model.prior_sd**2), estimate=run.model.prior_mean)
    told = deployed(["a", "b"], [None, None], [blind, blind], 0.01, np.random.default_rng(3))
    assert told.status == "cannot be seen"
    assert exit_code(told.status) == 5
    assert history_lines(told)[0].startswith("Nothing shows, but these calibrations could hardly show")
