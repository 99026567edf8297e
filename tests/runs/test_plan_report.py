"""The report is made of whatever stages have run: of a plan alone, and of a calibration."""

from __future__ import annotations

import html
import json
import re

import pytest

from calflow.reporting import document
from calflow.reporting.sections.plan import plan_section
from calflow.reporting.sections.verdict import verdict_section


@pytest.fixture
def verdict_alone(monkeypatch):
    """Reports of page one alone, for those who ask what a report is of."""
    monkeypatch.setattr(document, "sections", lambda: [verdict_section, plan_section])


def text(folder):
    """All that the page of a run's report says, in one line; the PDF has the same blocks."""
    assert (folder / "runs" / "report.pdf").stat().st_size > 10_000
    page = (folder / "runs" / "report.html").read_text(encoding="utf-8").partition("<body")[2]
    bare = re.sub(r"<(script|svg).*?</\1>", " ", page, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", bare)).split())


@pytest.fixture
def planned(small):
    """The study with a workflow that plans alone, and nothing measured."""
    (small / "plan.toml").write_text('name = "plan"\nstages = ["select", "report"]\n', encoding="utf-8")
    measured = '[measurements]\nfile = "measurements.csv"\n'
    asked = "poses = 8\ncandidates = 100\ntolerance_mm = 5\n"
    small.edit(
        "study.toml", ('workflow = "quick.toml"', 'workflow = "plan.toml"'), (measured, ""), ("poses = 8\n", asked)
    )
    (small / "measurements.csv").unlink()
    return small


def test_a_study_without_measurements_gets_a_report_of_its_plan(planned):
    """Fails if a plan's report asks for measurements, or page one lacks what the poses are worth, or what to do next."""
    answer = planned.calflow("run")
    assert answer.code == 0, answer.err
    assert "report.pdf" in answer.out
    said = text(planned)
    how_many = json.loads((planned / "runs" / "select" / "how_many.json").read_text(encoding="utf-8"))
    for words in (
        "Measurement plan", "8 poses make the tool's position certain to", "the tolerance of 5.00 mm is met", "Not computed:",
        f"the curve bends at {how_many['knee_poses']} poses", "Every pose measured twice", "The order of the poses",
        "What to do next", "What one addition is worth", "Appendix: the run",
    ):  # fmt: skip
        assert words in said, words
    assert "Calibration report" not in said


def test_the_report_command_tells_of_what_has_run(small, verdict_alone):
    """Fails if the report of a plan that has run waits for an identification, or a calibration's is made of its plan."""
    assert small.calflow("run", "--stage", "select").code == 0
    answer = small.calflow("report")
    assert answer.code == 0, answer.err
    assert "Measurement plan" in text(small)
    assert small.calflow("run", "--stage", "identify").code == 0
    assert small.calflow("report").code == 0
    assert "Calibration report" in text(small)


def test_a_report_of_nothing_goes_on_from_the_calibration(small, verdict_alone):
    """Fails if a study of which nothing has run is reported as a plan where it has measurements to identify from."""
    assert small.calflow("report").code == 0
    assert "Calibration report" in text(small)
