"""The stage select: poses for what the study asks, over the task that it names, and what it refuses."""

from __future__ import annotations

import json

import pandas as pd
import pytest

TASK = """
[stages.select.task]
region_min_mm = [300, -400, 200]
region_max_mm = [1300, 400, 1200]
payloads = ["heavy", ""]
"""


def selected(small, asked, task=TASK, out="runs"):
    """The table of what poses are worth, the certificate, and what was said, where a study asks so."""
    small.edit("study.toml", ("poses = 8\n", f'poses = 8\npayload = "light"\n{asked}\n{task}'))
    answer = small.calflow("run", "--stage", "select", "--out", small / out)
    small.edit("study.toml", (f'payload = "light"\n{asked}\n{task}', ""))
    assert answer.code == 0, answer.err
    folder = small / out / "select"
    certificate = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    return pd.read_csv(folder / "observability.csv").iloc[-1], certificate, answer.out


def test_poses_are_best_for_what_is_asked(small):
    """Fails if a criterion is taken for another: each is the best of the three in its own figure, over one task."""
    worth, certificates = {}, {}
    for aim in ("parameters", "tool", "worst"):
        worth[aim], certificates[aim], said = selected(small, f'criterion = "{aim}"', out=aim)
        assert certificates[aim]["criterion"] == aim
        assert f"by more than {certificates[aim]['could_gain_percent']:.2g} %" in said
    assert max(worth, key=lambda aim: worth[aim]["O1"]) == "parameters"
    assert min(worth, key=lambda aim: worth[aim]["expected_sd_mm"]) == "tool"
    assert min(worth, key=lambda aim: worth[aim]["worst_sd_mm"]) == "worst"
    assert certificates["tool"]["loss"] == pytest.approx(worth["tool"]["expected_sd_mm"], rel=1e-6)
    assert certificates["worst"]["loss"] == pytest.approx(worth["worst"]["worst_sd_mm"], rel=1e-6)
    for aim, name in (("tool", "expected_sd_mm"), ("worst", "worst_sd_mm")):
        assert all(certificates[aim]["least_loss"] <= worth[other][name] for other in worth)


def test_the_task_is_what_the_study_names(small):
    """Fails if the task's payloads or its poses do not count, or a task does not make the tool what poses are for."""
    loaded, certificate, _ = selected(small, "")
    assert certificate["criterion"] == "tool"
    bare, _, _ = selected(small, "", TASK.replace('["heavy", ""]', '[""]'), "bare")
    assert bare["expected_sd_mm"] < loaded["expected_sd_mm"]  # compliance is not asked for
    (small / "task.csv").write_text("q1_deg,q2_deg,q3_deg\n0,-90,90\n", encoding="utf-8")
    stated, _, _ = selected(small, "", '[stages.select.task]\nposes = "task.csv"\n', "stated")
    assert stated["expected_sd_mm"] == pytest.approx(stated["worst_sd_mm"])  # a single point


def test_suspected_causes_are_planned_for(small):
    """Fails if what is only suspected does not count among the parameters and in the tool's error."""
    without, plain, _ = selected(small, "")
    with_them, certificate, _ = selected(small, 'also_effects = ["link-bending"]', out="suspected")
    assert certificate["n_parameters"] > plain["n_parameters"]
    assert with_them["expected_sd_mm"] > without["expected_sd_mm"]


def test_what_cannot_be_planned_is_refused(small):
    """Fails if a cause that poses cannot tell of, or a payload of the task that nobody knows, is passed over."""
    causes = 'also_effects = ["joint-backlash", "joint-error-map"]'
    small.edit("study.toml", ("poses = 8", f"poses = 8\n{causes}\n{TASK}"), ('"heavy", ""', '"heavi"'))
    said = "\n".join(small.refused())
    for words in (
        "unknown payload 'heavi'; there are light, heavy, did you mean 'heavy'?",
        "poses cannot be chosen for 'joint-backlash', which needs columns approach1",
        "'joint-error-map' has no parameters before there are measurements",
    ):
        assert words in said
