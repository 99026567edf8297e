"""The history of a robot: what moved between its runs is named with its time, and runs that cannot tell are refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from applied import history
from calflow.calibration import Calibration
from calflow.deployment.history import history as deployed
from conftest import without_data


@pytest.fixture(scope="module")
def _measured_twice_more(_finished, tmp_path_factory):
    """The finished study, measured and identified twice more."""
    finished = _finished.copied(tmp_path_factory.mktemp("history") / "finished")
    for seed, name, change in ((5, "second", "0.5"), (6, "third", "0.8")):
        text = (finished / "truth.toml").read_text(encoding="utf-8")
        text = text.replace("seed = 3", f"seed = {seed}").replace("a_mm = 0.5", f"a_mm = {change}")
        (finished / "other.toml").write_text(text, encoding="utf-8")
        measured = finished / "measurements.csv"
        assert finished.calflow("simulate", finished / "other.toml", "--out", measured, "--force").code == 0
        with without_data():
            assert finished.calflow("run", "--stage", "identify", "--out", finished / name).code == 0
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
