"""The section on the order of the poses: what a drift that nobody sees would pull, and from which side joints come."""

from __future__ import annotations

from calflow.design.measuring_order import DriftPull
from calflow.files.words import mm
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

TOLD = "select/order.csv"
SAID = (
    "What wanders steadily while the poses are measured looks like an error of the robot, more or less by their order. Short is "
    "the order of short ways; random is in blocks of ten drawn from all poses, each on short ways, of fifty such orders the one "
    "that a drift pulls least. The device drifts one way, the worst; the robot grows from its base, as one that warms up."
)
VIAS = (
    "Each joint comes to its pose from a via (columns via1 …): straight, and from both sides in about equal numbers, so that play "
    "and friction are not taken for a matter of place."
)


def write(material: Material) -> list[Block]:
    """Tabulate what each drift would pull in each order."""
    rows = material.results.rows(TOLD, DriftPull)
    poses = material.tables["select/poses.csv"]
    cells = [
        [f"{row.order}, as planned" if row.taken else row.order, f"{row.travel:.2f}", f"{row.drifting} by {mm(row.drift_mm)} mm",
         mm(row.tool_pull_mm), f"{row.parameter}: {row.pull_sd:.1f} sd"]
        for row in rows
    ]  # fmt: skip
    head = ["order", "ways", "what drifts", "pulls the tool by [mm]", "pulls most"]
    via = [Paragraph(VIAS)] if any(str(name).startswith("via") for name in poses) else []
    return [Paragraph(SAID, keep=True), Table(head, cells, "lrlrl", wide=4), *via]


SECTION = Section(
    73,
    "The order of the poses",
    (TOLD, "select/poses.csv"),
    write,
    worth_telling=lambda results: len(results.tables[TOLD]) > 0,
)
