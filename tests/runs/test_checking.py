"""The check of a study tells all that a run would refuse, and how far the nominal robot is from what was measured."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest

from calflow.estimation import noise as noises
from calflow.estimation.accuracy import errors
from calflow.model import build
from calflow.study import load_study

COUNT = "poses = 8\n[stages.identify.count]\n"
REFUSED = {
    "no such payload": ("poses = 8", 'payload = "havy"',
                        "study.toml:14: stages.select.payload: unknown payload 'havy'; there are light, heavy, did you"),
    "no such marker": ("poses = 8", 'marker = "tol"', "study.toml:14: stages.select.marker: unknown marker 'tol'; there are tool"),
    "count of another effect": ("poses = 8", f"{COUNT}geometri = 3",
                                "study.toml:16: stages.identify.count.geometri: unknown effect 'geometri', did you mean"),
    "count below zero": ("poses = 8", f"{COUNT}geometry = -1",
                         "study.toml:16: stages.identify.count.geometry: expected a count from 0 to 17, as many parameters"),
    "count above all": ("poses = 8", f"{COUNT}joint-compliance = 4",
                        "study.toml:16: stages.identify.count.joint-compliance: expected a count from 0 to 3, as many parameters"),
    "walkers": ("poses = 8", "[stages.sample]\nwalkers = 35",
                "study.toml:15: stages.sample.walkers: 35 walkers are too few for 21 dimensions: expected at least 42"),
    "repeats that are none": ("poses = 8", '[stages.identify]\nnoise = "repeats"',
                              "study.toml:15: stages.identify.noise: noise = \"repeats\" needs poses that were measured several"),
    "confirmed by nothing": ("seed = 7", 'seed = 7\nconfirm = "other.toml"', "study.toml:5: confirm: there is no file "),
    "confirmed by itself": ("seed = 7", 'seed = 7\nconfirm = "study.toml"', "study.toml:5: confirm: is this study itself:"),
    "confirmed by itself, as a folder": ("seed = 7", 'seed = 7\nconfirm = "."', "study.toml:5: confirm: is this study itself"),
    "confirmed by a long name": ("seed = 7", f'seed = 7\nconfirm = "{9000 * "c"}"', "study.toml:5: confirm: cannot be read: File"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "expected"), REFUSED.values(), ids=REFUSED)
def test_what_a_run_would_refuse_is_told_beforehand(small, old, new, expected):
    """Fails if a study passes that a run stops at, or is told without its file and line."""
    if "repeats" in expected:
        small.measure(small.rows[small.rows["repeat"] == "1"])
    small.edit("study.toml", (old, new))
    (told,) = small.refused("check")
    assert told.startswith(expected)


def test_a_setting_of_the_workflow_is_told_there(small):
    """Fails if the study is blamed for what stands in its workflow."""
    small.edit("quick.toml", ("candidates = 100", 'candidates = 100\npayload = "havy"'))
    (told,) = small.refused("check")
    assert told.startswith("quick.toml:6: settings.select.payload: unknown payload 'havy'")


def test_too_few_poses_are_told_by_check(small):
    """Fails if a study passes that has fewer equations than parameters."""
    small.measure(small.rows[:12])
    (told,) = small.refused("check")
    assert told.startswith("measurements.csv: 12 equations (4 training poses) for 20 parameters: measure at least 7")


def test_the_independent_series_is_checked_too(small):
    """Fails if a fault of the confirming study's files ends a run after hours of search."""
    shutil.copytree(small.path, small / "other")
    small.edit("study.toml", ("seed = 7", 'seed = 7\nconfirm = "other"'))
    assert small.calflow("check").code == 0
    small.measure(small.rows.assign(payload="havy"), "other/measurements.csv")
    assert small.refused("check")[0].startswith("other/measurements.csv:2: unknown payload 'havy'")
    small.edit("other/robot.toml", ("[[joints]]", "[[joints]]\nmass_kg = 0\n[[joints]]"))
    assert small.refused("check") == ["study.toml:5: confirm: expected a robot with 3 joints, found 4"]


@pytest.mark.parametrize("known", [True, False])
def test_the_nominal_robot_s_error_is_told(small, known):
    """Fails if a base that nobody knows counts as an error, or mean and largest error are not those of the rows."""
    if not known:
        rows = small.rows
        small.measure(rows.assign(x_mm=rows["x_mm"].astype(float) + 2000))
        small.edit("robot.toml", ("[[joints]]", "[base]\nknown = false\n[[joints]]"))
    answer = small.calflow("check")
    assert answer.code == 0
    assert f"base and tool {'as the robot file says' if known else 'placed by the poses to fit'}:" in answer.out
    told = re.findall(r"(train|holdout) +mean ([\d.]+) mm, max ([\d.]+) mm", answer.out)
    assert [split for split, _, _ in told] == ["train", "holdout"]
    study = load_study(small.path)
    data, nominal = study.measurements(), build(study.robot, (), ("order",))
    distance = 1e3 * np.linalg.norm(errors(nominal, nominal.nominal, data), axis=1)
    for (_, mean, largest), mask in zip(told, (data.train, data.held_out), strict=True):
        if known:
            assert (float(mean), float(largest)) == pytest.approx(
                (distance[mask].mean(), distance[mask].max()), abs=6e-4
            )
        else:
            assert float(mean) < float(largest) < 2


@pytest.mark.parametrize(("noise", "times"), [("auto", 0), ("file", 1)])
def test_the_noise_is_looked_for_without_a_prediction_where_none_is_asked_for(small, monkeypatch, noise, times):
    """Fails if a check predicts the nominal robot once more than for what it tells, or no longer for repeats that are asked for."""
    small.edit("quick.toml", ("[settings.identify]\n", f'[settings.identify]\nnoise = "{noise}"\n'))
    asked = []
    told = noises.leading_errors
    monkeypatch.setattr(noises, "leading_errors", lambda *given: asked.append(1) or told(*given))
    small.calflow("check")
    assert len(asked) == times
