"""Robots of a fleet that something else than a tracker saw: judged in the unit that was measured."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pandas as pd
import pytest

from calflow.files.tables import from_frame
from calflow.fleet.fleet_report import fleet_report
from calflow.fleet.standing import Outcome, fleet_lines, worst_first
from calflow.reporting.blocks import Paragraph
from fleet.plant import IDENTIFY
from observations.newcomer import said, simulated, study
from observations.pinhole import Pinhole
from observations.test_pinhole import FOCAL, MIDDLE, NOISE, image

SETTINGS = (
    f"sigma_px = {NOISE}\n\n[measurements.settings]\nfocal_px = {FOCAL}\nmiddle_px = {list(MIDDLE)}\n"
    "origin_mm = [3500, 400, 900]\nrotation_deg = [-90, -90, 0]\n"
)
FLEET = """\
[fleet]
name = "cameras"

[types.camera]
study = "study.toml"
data = "data/{robot}.csv"
"""


def test_robots_seen_by_a_camera_are_judged_in_pixels(small, tmp_path):
    """Fails if a fleet takes it for granted that lengths were measured, in its tables, its sentences or its report."""
    made = simulated(60, 8)
    environment = study(small, tmp_path / "site", Pinhole, made, image(made), SETTINGS)
    (small / "quick.toml").write_text(IDENTIFY, encoding="utf-8")
    (small / "plant.toml").write_text(FLEET, encoding="utf-8")
    (small / "data").mkdir()
    for robot in ("P-1", "P-2"):
        shutil.copy(small / "measurements.csv", small / "data" / f"{robot}.csv")
    for robot in ("P-1", "P-2"):  # as the engine has it done, which is tested elsewhere
        said(small, environment, "fleet", "calibrate", "plant.toml", robot, "--out", "out")
    said(small, environment, "fleet", "report", "plant.toml", "--out", "out")
    told = said(small, environment, "fleet", "status", "plant.toml", "--out", "out")
    assert "Half of them have a mean error of " in told
    assert " px or less (before: " in told
    rows = from_frame(pd.read_csv(small / "out" / "fleet.csv"), Outcome)
    accuracy = pd.read_csv(small / "out" / "robots" / "P-1" / "identify" / "accuracy.csv")
    judged = accuracy[accuracy["split"] == "holdout"]
    for row in rows:
        assert (row.status, row.unit, row.before_mean_mm) == ("calibrated", "px", None)
        assert (row.before_mean, row.after_mean) == pytest.approx((judged["mean"].iloc[0], judged["mean"].iloc[-1]))
        assert (row.before_max, row.after_max) == pytest.approx((judged["max"].iloc[0], judged["max"].iloc[-1]))
    page = (small / "out" / "report.html").read_text(encoding="utf-8")
    assert "mean before [px]" in page
    assert "[mm]" not in page


def outcome(robot: str, unit: str, after: float) -> Outcome:
    """What came of a robot."""
    lengths = {"before_mean_mm": 2 * after, "after_mean_mm": after} if unit == "mm" else {}
    return Outcome(
        robot=robot, type="t", status="calibrated", unit=unit, before_mean=2 * after, after_mean=after, **lengths
    )


def test_errors_of_different_units_are_not_held_against_each_other():
    """Fails if pixels are ordered, halved or drawn as millimetres where a plant has both."""
    found = [outcome("a", "px", 0.9), outcome("b", "mm", 0.1), outcome("c", "px", 0.4), outcome("d", "mm", 0.2)]
    assert [one.robot for one in worst_first(found)] == ["d", "b", "a", "c"]
    assert fleet_lines(found)[1:] == [
        "Half of those that are judged in px have a mean error of 0.650 px or less (before: 1.30 px); the worst one, a, is left "
        "with 0.900 px.",
        "Half of those that are judged in mm have a mean position error of 0.150 mm or less (before: 0.300 mm); the worst one, d, "
        "is left with 0.200 mm.",
    ]
    (_, _), (_, [_, table]) = fleet_report("plant", found, ())
    before = table.header.index("mean before")
    assert [row[before] for row in table.rows] == ["0.400 mm", "0.200 mm", "1.80 px", "0.800 px"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "choose check poses (calflow check-poses)"),
        ({"status": "not run"}, "Run the fleet on"),
        ({"usable": False, "next_step": "Correct the lines."}, "b first. Correct the lines."),
        ({"status": "failed"}, "b first. Correct what stopped its run."),
    ],
)
def test_a_fleet_s_page_says_what_to_do_next(changes, words):
    """Fails if the page leaves its reader without a next step, or does not begin with the worst robot."""
    found = [outcome("a", "mm", 0.3), replace(outcome("b", "mm", 0.1), **changes)]
    (_, page), _ = fleet_report("plant", found, ())
    assert any(isinstance(block, Paragraph) and words in block.text for block in page)
