"""Page one is for a reader who knows robots and no statistics; what the report says twice it says alike."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from calflow.deployment.run_outcome import RunOutcome
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.estimation.certainty import Certainty
from calflow.estimation.identifiability import scale_words
from calflow.files.tables import from_document, to_document
from calflow.reporting.document import write_pdf
from calflow.reporting.sections.verdict import next_steps, verdict_section
from calflow.reporting.sections.verdict import tested_words as words_of
from calflow.reporting.style import style
from calflow.stages.report import STAGE, report_material
from calflow.stages.stage import Context
from calflow.study import Acceptance
from reporting.case import (
    BACKLASH,
    COUPLED,
    MISFIT,
    OR_HYSTERESIS,
    ORDER_OPEN,
    STEP,
    WAVING,
    Case,
    context,
    with_diagnosis,
    with_sample,
    with_select,
)
from reporting.page_one import page_one, texts, unfit, unreadable
from reporting.pdf import pages_of, smallest_print
from reporting.test_advice import QUIET, SPEAKS, in_space, promised, results
from reporting.test_html import Reader

LONG_NAMES = (
    "loaded-transmission-error 2; nonlinear-joint-stiffness 3; joint-error-map 1; periodic-joint-error 3; frame-drift 0"
)
MANY = replace(BACKLASH, status="one_of", rivals=LONG_NAMES)
FOUND = [(), (BACKLASH, MISFIT), (OR_HYSTERESIS, COUPLED, WAVING), (ORDER_OPEN,), (MANY, STEP)]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Context:
    return context(tmp_path_factory.mktemp("small"), Case(markers=("tool",)))


@pytest.fixture(scope="module")
def written(small: Context, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole report of what may have several names, and of something unexplained."""
    folder = tmp_path_factory.mktemp("written")
    given = with_sample(with_select(with_diagnosis(small, OR_HYSTERESIS, COUPLED)))
    STAGE.run(replace(given, folder=folder))
    return folder


@pytest.mark.parametrize("found", FOUND)
def test_page_one_is_short_and_without_jargon(small: Context, found: tuple[object, ...]) -> None:
    """Fails if page one names a parameter or a study's key, a figure of statistics, or has a sentence that nobody reads whole."""
    given = with_sample(with_diagnosis(small, *found))  # type: ignore[arg-type]
    material = report_material(given.study, given.results, given.run_folder)
    said = page_one(material)
    assert unreadable(said) == []
    assert len([text for text in said if re.match(r"Tested: \d+ of \d+ held-out errors", text)]) == 1


def test_page_one_is_legible(small: Context, tmp_path: Path) -> None:
    """Fails if what to do next is in small print where much was found, much stays open and the errors will not last."""
    given = with_diagnosis(small, MANY, STEP, ORDER_OPEN, OR_HYSTERESIS, COUPLED, MISFIT, WAVING, BACKLASH)
    certainty = given.results.document("diagnose/certainty.json", Certainty)
    document = to_document(replace(certainty, expected_mm=(0.05, 0.055, 0.09)))
    results = replace(given.results, documents={**given.results.documents, "diagnose/certainty.json": document})
    material = report_material(given.study, results, given.run_folder)
    with style():
        write_pdf(material.title, [("", verdict_section.write(material)), ("Next", [])], tmp_path)
    assert smallest_print((tmp_path / "report.pdf").read_bytes()) >= 8


@pytest.mark.parametrize(("rule", "tables"), [(rule, tables) for rule, tables, *_ in SPEAKS])
def test_what_is_advised_is_short(rule: object, tables: dict[str, object]) -> None:
    """Fails if a rule gives advice in a sentence of more than thirty words, or by a study's key."""
    assert unfit([item.sentence for item in rule(results({**QUIET, **tables}))]) == []  # type: ignore[operator]


@pytest.mark.parametrize("wholly", [True, False])
def test_what_cannot_be_told_is_short(small: Context, wholly: bool) -> None:
    """Fails if page one of a run without a known noise, or without a known length, has a sentence of more than thirty words."""
    summary = with_diagnosis(small).results.document("diagnose/summary.json", DiagnosisSummary)
    said = (scale_words(wholly), replace(summary, noise_sources=("estimated",)).unseen)
    assert all(said)
    assert unreadable(said) == []


def test_a_stage_without_results_is_told(small: Context) -> None:
    """Fails if a report of identify alone, diagnosis being outdated, looks like one of the study's whole workflow, or says of a
    stage that failed that it was not run.
    """
    material = report_material(small.study, small.results, small.run_folder)
    line = "without the stage diagnose: not run, or outdated since"
    whole = replace(material, settings={"identify": {}, "diagnose": {}, "report": {}})
    assert line in page_one(whole)
    assert "without the stage diagnose: failed" in page_one(replace(whole, stopped={"diagnose": "failed"}))
    assert line not in page_one(replace(material, settings={"identify": {}, "report": {}}))


@pytest.mark.parametrize(("later", "said"), [(0.09, True), (0.06, False)])
def test_a_calibration_that_will_not_last_says_so(small: Context, later: float, said: bool) -> None:
    """Fails if page one is silent where the error promised a day later is much larger, or speaks of it where it is not."""
    given = with_diagnosis(small)
    certainty = given.results.document("diagnose/certainty.json", Certainty)
    document = to_document(replace(certainty, expected_mm=(0.05, 0.055, later)))
    results = replace(given.results, documents={**given.results.documents, "diagnose/certainty.json": document})
    shown = page_one(report_material(given.study, results, given.run_folder))
    sentences = [text for text in shown if text.startswith("When: the promised error grows from 0.050 to 0.090 mm")]
    assert len(sentences) == said
    assert all(text.endswith(": check some poses before use.") for text in sentences)
    assert unreadable(shown) == []


def test_a_size_that_nobody_measured_is_told(small: Context) -> None:
    """Fails if page one promises errors by images of a board without a word on what an error of the board's own size adds."""
    given = with_diagnosis(small)
    certainty = given.results.document("diagnose/certainty.json", Certainty)
    document = to_document(replace(certainty, reach_m=(0.4, 0.8), heights_m=(-0.6, 0.5)))
    results = replace(given.results, documents={**given.results.documents, "diagnose/certainty.json": document})
    assert not any("Size:" in text for text in page_one(report_material(given.study, results, given.run_folder)))
    beside = replace(results, tables={**results.tables, "identify/in_space.csv": in_space(0.2, 0.3, 0.4)})
    assert not any("Size:" in text for text in page_one(report_material(given.study, beside, given.run_folder)))
    alone = replace(given.results.document("diagnose/summary.json", DiagnosisSummary), new_poses_mm=None)
    of_images = replace(beside, documents={**beside.documents, "diagnose/summary.json": to_document(alone)})
    shown = page_one(report_material(given.study, of_images, given.run_folder))
    far = "if it is 0.1 % larger, the tool is off by up to 1.00 mm more"
    assert [text for text in shown if "Size:" in text] == [f"Size: the board's counts as exact; {far}."]
    assert unreadable(shown) == []


def test_a_good_calibration_is_to_be_used_before_anything_else(small: Context) -> None:
    """Fails if a report in which nothing is wrong begins its advice with more work."""
    assert next_steps(RunOutcome(with_diagnosis(small).results))[0].sentence.startswith("Use it for")
    assert not next_steps(RunOutcome(with_diagnosis(small, COUPLED).results))[0].sentence.startswith("Use it for")


def test_a_simulated_robot_is_not_to_be_used(small: Context) -> None:
    """Fails if a simulation's first step is to use it, or says that nothing needs attention."""
    given = with_diagnosis(small)
    material = report_material(given.study, given.results, given.run_folder)
    asked = material.request.model_copy(update={"acceptance": Acceptance.model_validate({"simulated": True})})
    said = page_one(replace(material, request=asked))
    assert "Measure the real robot." in said
    assert not [text for text in said if text.startswith("Use it") or "attention" in text]


NUMBER = re.compile(r"[−+]?\d[\d,]*\.?\d*")


class Cells(Reader):
    """Reads a page's text, each of its pieces apart."""

    def handle_data(self, data: str) -> None:
        super().handle_data(f"{data} ")


def test_pdf_and_page_say_the_same(written: Path) -> None:
    """Fails if a figure stands in the page alone, or in the PDF alone: both are written from the same blocks."""
    pdf = "\n".join(pages_of((written / "report.pdf").read_bytes()))
    page = Cells()
    page.feed((written / "report.html").read_text(encoding="utf-8"))
    numbers = [set(NUMBER.findall(text)) for text in (pdf, page.text)]
    only_on_paper = set(NUMBER.findall(" ".join(re.findall(r"^.*\d+ ?/ ?\d+$", pdf, re.M))))  # of the pages
    assert numbers[1] - numbers[0] == set()
    assert numbers[0] - numbers[1] - only_on_paper == set()


def test_who_measured_what_when_stands_on_every_page(small: Context, tmp_path: Path) -> None:
    """Fails if a page does not say which robot it is of, or leaves unsaid that nobody stated it."""
    material = report_material(small.study, small.results, small.run_folder)
    with style():
        assert "not stated: serial number, date, instrument, operator" in set(texts(verdict_section.write(material)))
        asked = Acceptance.model_validate({"serial_number": "R-17", "operator": "A. Meister"})
        signed = replace(material, request=material.request.model_copy(update={"acceptance": asked}))
        assert "serial number R-17  ·  operator A. Meister  ·  not stated: date, instrument" in set(
            texts(verdict_section.write(signed))
        )


@pytest.mark.parametrize(
    ("within", "so_few", "told"),
    [
        (60, 1.0, "95 % limits."),
        (54, 0.077, "That may be chance."),
        (51, 0.026, "That is few"),
        (44, 1e-4, "too narrow."),
    ],
)
def test_a_share_below_its_promise_is_judged(within: int, so_few: float, told: str) -> None:
    """Fails if the reader is left to guess whether fewer errors below their limit than promised are chance."""
    (document,) = promised(within, so_few).values()
    assert told in words_of(from_document(document, Certainty))
