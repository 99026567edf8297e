"""The report tells what was wrong with the data, and is written without the rows that were left out."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import judgement
from calflow.faults import Correction, Fault, as_table
from calflow.faults.base import fault
from calflow.files.tables import Results
from calflow.reporting.advice import advice
from calflow.reporting.document import source, write_pdf
from calflow.reporting.section import sections
from calflow.reporting.sections import faults as section
from calflow.stages.report import report_material
from calflow.stages.stage import Context
from reporting.case import chosen, context


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Context:
    """A small identified study whose third row was left out and whose first joint counts the other way."""
    given = context(tmp_path_factory.mktemp("small"))
    data = given.study.measurements()
    out = fault("outlier", data, 0, [Correction(3)], "left out", "the position in LINES is 9 mm off; left out")
    turned = Fault(
        "joint-sign", 1, (), "joint 1: all readings have the wrong sign", "corrected", (Correction(0, "q1", -1.0),)
    )
    residuals = given.tables["identify/residuals.csv"].copy()
    residuals.loc[2, ["split", "dx_mm"]] = ["", 1e6]
    table = as_table((out, turned), data)
    return replace(
        given, results=given.results | Results({"identify/faults.csv": table, "identify/residuals.csv": residuals})
    )


def test_left_out_rows_are_in_no_figure(small: Context) -> None:
    """Fails if a row that was left out counts as held out, or its error as one of the model's."""
    material = report_material(small.study, small.results, small.run_folder)
    residuals = small.tables["identify/residuals.csv"]
    assert len(material.data) == len(material.error) == len(residuals) - 1
    assert material.held.sum() == (residuals["split"] == "holdout").sum()
    assert material.distance.max() < 1e3


def test_the_reader_is_told_to_correct_the_file(small: Context) -> None:
    """Fails if a fault is not told on page one, a whole column after single rows, or without its lines."""
    material = report_material(small.study, small.results, small.run_folder)
    text = source("", [("", section.faults_section.write(material))])
    for words in ("line 4", "left out", "all rows", "corrected", "The position in line 4 is 9 mm off. Left out."):
        assert words in text
    told = [item.sentence for item in advice(RunOutcome(small.results)) if item.sentence.startswith("Correct the meas")]
    assert told == [
        "Correct the measurement file: joint 1: all readings have the wrong sign.",
        "Correct the measurement file: the position in line 4 is 9 mm off. Left out.",
    ]


def test_an_unsettled_mistake_is_the_one_thing_to_do(small: Context) -> None:
    """Fails if a mistake of the robot file is said to be corrected, or of the measurements, or page one asks for more."""
    statement = "a of joint 3 is mistyped; expected about a_mm = 1075 for joint 3 in the robot file, found 1105"
    mistyped = Fault("figure-mistyped", 3, (), statement, "unsettled", (Correction(0),), "robot file")
    residuals = small.tables["identify/residuals.csv"].copy()
    residuals.loc[2, ["split", "dx_mm"]] = ["train", 0.1]
    faults = as_table((mistyped,), small.study.measurements())
    results = small.results | Results({"identify/faults.csv": faults, "identify/residuals.csv": residuals})
    material = report_material(small.study, results, small.run_folder)
    text = source("", [("", section.faults_section.write(material))])
    assert "robot file" in text
    assert "nothing: settle it first" in text
    assert not [words for words in ("corrected", "left out", "all rows") if words in text]
    (only,) = advice(RunOutcome(results))
    said = "a of joint 3 is mistyped. Expected about a_mm = 1075 for joint 3 in the robot file, found 1105."
    assert only.sentence == f"Do not use this result. There is a mistake in the robot file: {said}"
    assert judgement(RunOutcome(results)) == "Do not use this model: a mistake is to be settled first."
    assert not [one.title for one in chosen(sections(), material) if "causes" in one.title]


def test_the_section_is_there_where_faults_are(small: Context, tmp_path) -> None:
    """Fails if a report without faults has an empty section, or one with faults cannot be written."""
    material = report_material(small.study, small.results, small.run_folder)
    assert section.faults_section in chosen(sections(), material)
    none = small.results | Results({"identify/faults.csv": small.tables["identify/faults.csv"].iloc[:0]})
    assert section.faults_section not in chosen(sections(), replace(material, results=none))
    write_pdf(
        "title", [("Verdict", []), (section.faults_section.title, section.faults_section.write(material))], tmp_path
    )
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
