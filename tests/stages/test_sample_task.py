"""The task that a study names: what a run says of it, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from conftest import without_data

TASK = """
[stages.sample.task]
poses = "task.csv"
path = true
payloads = ["heavy", "light"]
tolerance_mm = 0.5
turn_tolerance_mrad = 1.0
"""


@pytest.fixture(scope="module")
def run(_measured, tmp_path_factory):
    """A finished run of the small study with a path of twelve numbered points under two loads, and its folder."""
    import shutil

    folder = type(_measured)(tmp_path_factory.mktemp("task") / "small")
    shutil.copytree(_measured.path, folder.path)
    turn = np.linspace(-60, 60, 12)
    rows = {"pose": range(12), "q1_deg": turn, "q2_deg": -30 + 0.2 * turn, "q3_deg": 60 - 0.3 * turn}
    folder.measure(pd.DataFrame(rows).assign(payload="light"), "task.csv")
    folder.edit("study.toml", ("[stages.select]", f"{TASK}\n[stages.select]"))
    folder.edit(
        "quick.toml",
        ('["select", "identify", "sample"]', '["identify", "sample", "report"]'),
        ("[settings.select]\ncandidates = 100\n", ""),
    )
    folder.edit("study.toml", ("\n[stages.select]\nposes = 8\n", ""))
    with without_data():
        answer = folder.calflow("run")
    assert answer.code == 0, answer
    return folder


def test_every_point_is_told_under_every_load(run):
    """Fails if a pose or a load is lost, an error grows where the tool stays, or the columns contradict each other."""
    table = pd.read_csv(run / "runs/sample/task.csv")
    assert list(table["point"]) == [*range(12)] * 2
    assert list(table["payload"]) == ["heavy"] * 12 + ["light"] * 12
    assert (table["expected_mm"] < table["radius95_mm"]).all()
    sd = np.sqrt((table[["sd_x_mm", "sd_y_mm", "sd_z_mm"]] ** 2).sum(axis=1))
    assert (table["expected_mm"] < sd).all()
    assert (table["nominal_mm"] > table["radius95_mm"]).any()
    assert table["within"].between(0, 1).all()


def test_the_whole_is_no_surer_than_its_least_sure_point(run):
    """Fails if the probability of all points is the product, or the mean, of theirs."""
    told = json.loads((run / "runs/sample/task_summary.json").read_text())
    assert told["points"] == 24
    assert told["in_order"]
    assert told["tolerance_mm"] == pytest.approx(0.5)
    assert told["turn_tolerance_mrad"] == pytest.approx(1.0)
    assert told["all_within"] <= told["least_within"] + 1e-9
    assert told["all_within_alike"] <= told["least_within"] + 0.03


def test_the_report_answers_on_its_first_page(run):
    """Fails if the answer to what the study asks is not told, or the figures are not drawn."""
    page = (run / "runs/report.html").read_text(encoding="utf-8")
    assert "points of the path are within 0.500 mm and 1.00 mrad" in page
    assert "How accurate the task is done" in page
    figures = {path.stem for path in (run / "runs/figures").glob("*.svg")}
    assert {"task_map", "task_path"} <= figures


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ('poses = "there.csv"', "there.csv"),
        ("tolerance_mm = 1", "expected either poses, a CSV, or region_min and region_max"),
        ("path = true\nregion_min_m = [0, 0, 0]\nregion_max_m = [1, 1, 1]", "a path needs its poses"),
        ('region_min_m = [0, 0, 0]\nregion_max_m = [1, 1, 1]\npayloads = ["heavi"]', "unknown payload 'heavi'"),
    ],
)
def test_a_task_that_cannot_be_answered_is_refused(small, task, said):
    """Fails if a run begins though its task names a file, a load or a place that is not there."""
    small.edit("study.toml", ("[stages.select]", f"[stages.sample.task]\n{task}\n\n[stages.select]"))
    assert any(said in line for line in small.refused("run"))


def test_a_task_s_mistake_is_told_before_anything_is_sampled(small):
    """Fails if minutes go by before a stage that is run by itself finds its file missing."""
    assert small.calflow("run", "--stage", "identify").code == 0
    workflow = (small / "quick.toml").read_text(encoding="utf-8")
    (small / "quick.toml").write_text(workflow.replace(', "sample"', ""), encoding="utf-8")
    small.edit("study.toml", ("[stages.select]", '[stages.sample.task]\nposes = "there.csv"\n\n[stages.select]'))
    answer = small.calflow("run", "--stage", "sample")
    assert answer.code == 2
    assert answer.err.strip().endswith("there.csv: no such file")
    assert not any((small / "runs").rglob("chain.h5"))
