"""The section on what planned poses tell apart: which causes they would show, and which gaps could be filled."""

from __future__ import annotations

from calflow.design.isolability.told_apart import isolability_gaps, isolability_summary
from calflow.files.results import Results
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.figures.isolability import isolability
from calflow.reporting.material import Material
from calflow.reporting.section import Advice, Section

TABLE = "select/isolability.csv"
FIRST = 3  # gaps on the first page
CAPTION = (
    "What the planned poses tell apart, if one cause of a row is there at the size stated: white, it is seen and told from the "
    "cause of the column in 9 of 10 measurements; dark, it is seen and not told from it; hatched, it is not seen. Causes that "
    "lack a column or a figure of the robot have no row."
)


def write(material: Material) -> list[Block]:
    """Show the matrix, and say every gap that something fills."""
    table = material.tables[TABLE]
    return [
        Paragraph(f"{_sentence(isolability_summary(table))} Before anything is measured this follows from the model, the "
                  "device's noise and the tests of diagnose; a cause is taken at its usual size, in any direction.", keep=True),
        Plot("isolability", isolability(table), CAPTION, table),
        *(Paragraph(_sentence(words)) for words in isolability_gaps(table)),
        Paragraph(f"All chances, and what nothing tried fills, are in {TABLE}."),
    ]  # fmt: skip


def add_to_the_plan(results: Results) -> list[Advice]:
    """Say on the first page what should be added to the plan."""
    return [Advice(3, _sentence(words)) for words in isolability_gaps(results.tables[TABLE])[:FIRST]]


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


SECTION = Section(71, "What these poses tell apart", (TABLE,), write, (add_to_the_plan,))
