"""Data faults: what was wrong in which file, and what was done about it."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.deployment.run_outcome import FAULTS
from calflow.faults.base import FaultyRow, lines_in_words
from calflow.files.words import effect_words, first_up
from calflow.reporting.advice import faults_by_rows
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import section

LINES_NAMED = 12  # lines of a file that are listed
FOUND = "Gross mistakes in the measurement file, the robot file or the set-up, found before any fit."
DONE = {  # by action: the table's entry, and a sentence
    "unsettled": (
        "nothing: settle it first",
        "Unsettled mistakes were left in: they affect the fit and the verdict, and no cause is named before they are settled.",
    ),
    "corrected": (
        "corrected for this run only",
        "Mistakes with one clear correction were corrected for this run only.",
    ),
    "left out": ("left out", "Rows without a clear correction were left out of the fit and the verdict."),
    "told": ("nothing: look at it", "What may be right is only reported."),
}
UNCHANGED = "The files themselves were not changed: correct them."


@section(5, "Data faults", FAULTS, lambda outcome: len(outcome.tables[FAULTS]) > 0)
def faults_section(material: Material) -> list[Block]:
    """Tabulate each fault with its lines and what was done, then state each in a sentence."""
    faults = faults_by_rows(material)
    rows = [
        (effect_words(rows[0].cause), str(rows[0].joint or "–"), rows[0].where, _lines(rows), DONE[rows[0].action][0])
        for rows in faults
    ]
    actions = {rows[0].action for rows in faults}
    meant = [words for action, (_, words) in DONE.items() if action in actions]
    return [
        Paragraph(" ".join([FOUND, *meant, *([UNCHANGED] if actions & {"corrected", "left out"} else [])]), keep=True),
        Table(("fault", "joint", "in the", "lines", "what was done"), rows, "lrlll", wide=3),
        *(Paragraph(first_up(rows[0].sentences)) for rows in faults),
    ]


def _lines(rows: Sequence[FaultyRow]) -> str:
    lines = [row.line for row in rows if row.line is not None]
    if rows[0].action == "unsettled":
        return "–"
    return lines_in_words(lines, LINES_NAMED) if lines else "all rows"
