"""What is signed: the verdict against a tolerance, and the facts that the study states."""

from __future__ import annotations

import datetime
from dataclasses import replace

import pytest

from calflow.reporting.blocks import Card, Columns, Signatures, Table
from calflow.reporting.section import sections
from calflow.reporting.sections import acceptance, verdict
from calflow.reporting.sections.acceptance import Judged
from calflow.reporting.style import style
from calflow.stages.report import report_material
from calflow.study import Acceptance
from reporting.case import Case, chosen, context


@pytest.mark.parametrize(
    ("judged", "begins"),
    [
        (Judged(0.15, 60, 60, 0.124, False),
         "✓ PASSED: all 60 held-out poses within 0.150 mm, with corrected commands. The largest error is 0.124 mm."),
        (Judged(0.15, 60, 57, 0.2, False), "✗ FAILED: 3 of 60 held-out poses beyond"),
        (Judged(0.15, 60, 60, 0.124, True), "✗ FAILED: the model is not to be used"),
        (Judged(0.15, 0, 0, 0.0, False), "NOT JUDGED"),
    ],
)  # fmt: skip
def test_the_verdict_says_what_was_judged(judged: Judged, begins: str) -> None:
    """Fails if a model that is not to be used passes, or one that nobody tested, or it is left open what the robot is given."""
    assert judged.verdict.startswith(begins)


def test_each_level_of_effort_is_held_against_the_tolerance(tmp_path) -> None:
    """Fails if figures that would not do pass with what corrected commands do."""
    given = context(tmp_path, Case(payload=False))
    material = report_material(given.study, given.results, given.run_folder)
    largest = [level.max for level in material.levels.every]
    asked = Acceptance.model_validate({"tolerance_mm": (min(largest) + max(largest)) / 2})
    signed = replace(material, request=material.request.model_copy(update={"acceptance": asked}))
    table, meant = verdict.levels_of_effort(signed)
    assert "each target" in meant.text
    assert [row[-1] for row in table.rows] == [
        "✓ PASSED" if level <= 1e3 * asked.tolerance else "✗ FAILED" for level in largest
    ]
    assert {row[-1] for row in table.rows} == {"✓ PASSED", "✗ FAILED"}


def test_few_poses_promise_little() -> None:
    """Fails if the share of other poses within the tolerance is not Clopper and Pearson's lower limit."""
    assert Judged(0.1, 59, 59, 0.0, False).share == pytest.approx(0.05 ** (1 / 59))
    assert Judged(0.1, 59, 0, 1.0, False).share == 0
    assert Judged(0.1, 0, 0, 0.0, False).share_words == ""


def test_a_study_that_states_it_is_signed(tmp_path) -> None:
    """Fails if page one does not give the verdict, a stated fact is lost, or it is to be signed while one is open."""
    given = context(tmp_path)
    material = report_material(given.study, given.results, given.run_folder)
    stated = {
        "serial_number": "R-1 <b>",
        "instrument": "tracker 7",
        "operator": "A. Smith",
        "date": datetime.date(2025, 11, 20),
        "temperature_degC": 21.4,
        "tolerance_mm": 1.0,
    }
    asked = Acceptance.model_validate(stated)
    signed = replace(material, request=material.request.model_copy(update={"acceptance": asked}))
    assert acceptance.acceptance_section not in chosen(sections(), material)
    assert acceptance.acceptance_section in chosen(sections(), signed)
    blocks = acceptance.acceptance_section.write(signed)
    (table,) = [block for block in blocks if isinstance(block, Table)]
    assert {("serial number", "R-1 <b>"), ("date", "2025-11-20"), ("temperature", "21.4 °C")} < set(table.rows)
    assert "certificate of the instrument" not in dict(table.rows)
    assert any(isinstance(block, Signatures) for block in blocks)
    with style():
        cards = [card for block in verdict.verdict_section.write(signed) if isinstance(block, Columns)
                 for part in block.parts for card in part if isinstance(card, Card)]  # fmt: skip
    passed = "all 12 held-out poses within 1.00 mm, with corrected commands"
    assert ("✓ PASSED", passed) in {(card.big, card.small) for card in cards}
    anonymous = asked.model_copy(update={"serial_number": "", "operator": ""})
    unsigned = replace(material, request=material.request.model_copy(update={"acceptance": anonymous}))
    card = acceptance.verdict_card(unsigned)
    assert (card.big, card.small) == ("NOT YET", f"{passed}; not stated: serial number, operator")
    blocks = acceptance.acceptance_section.write(unsigned)
    (table,) = [block for block in blocks if isinstance(block, Table)]
    assert {("serial number", "open: not stated"), ("operator", "open: not stated")} < set(table.rows)
    assert not any(isinstance(block, Signatures) for block in blocks)
    assert any("State the serial number and operator first" in getattr(block, "text", "") for block in blocks)
