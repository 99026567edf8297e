"""The section on what one thing more is worth: a payload, a marker, a station, a repeat, ten poses."""

from __future__ import annotations

from calflow.design.worth import Worth
from calflow.files.words import cut, first_up, mm, number
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

TOLD = "select/worth.csv"
SAID = (
    "By how much the tool would be surer over the task if one thing more were measured, all else as planned. Only what is not "
    "known of the parameters counts: causes that a payload or a marker would show come on top. What a second station or marker "
    "has to tell of its own place is taken off."
)


def write(material: Material) -> list[Block]:
    """Tabulate the additions, the one that gains most first."""
    rows = material.results.rows(TOLD, Worth)
    cells = [
        [first_up(row.addition) or "As planned", str(row.n_poses), str(row.n_points), mm(row.expected_sd_mm),
         f"{row.gain_percent:.0f} %" if row.addition else "", ", ".join(_gaining(row))]
        for row in rows
    ]  # fmt: skip
    head = ["addition", "poses", "points", "tool sd [mm]", "less by", "what gains most (its sd less by)"]
    return [Paragraph(SAID, keep=True), Table(head, cells, "lrrrrl", wide=0, size=8.4)]


def _gaining(row: Worth) -> list[str]:
    return [
        f"{cut(name)} {number(fall, '.0f')} %" for name, fall in zip(row.parameters, row.falls_percent, strict=True)
    ]


SECTION = Section(72, "What one thing more is worth", (TOLD,), write)
