"""Further steps: what is advised besides what the first page has room for."""

from __future__ import annotations

from calflow.reporting.blocks import Block, Bullets
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.sections.verdict import next_steps


def write(material: Material) -> list[Block]:
    """List them, the most urgent first."""
    return [Bullets(next_steps(material.results)[1])]


SECTION = Section(
    4,
    "Further steps",
    ("identify/accuracy.csv", "identify/summary.json", "identify/identifiability.csv"),
    write,
    worth_telling=lambda results: bool(next_steps(results)[1]),
)
