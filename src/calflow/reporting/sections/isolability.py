"""Isolability: which causes the planned poses detect and distinguish, and how gaps could be filled."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from calflow.design.isolability import IsolabilityCell, isolability_gaps, isolability_summary
from calflow.files.deferred import pd
from calflow.files.tables import from_frame
from calflow.files.words import first_up
from calflow.reporting.advice import ISOLABILITY_TABLE
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, LIGHT, chart

ROW, HIGHEST = 0.115, 7.0  # inches per cause, and of all together
WIDE = 5.2  # inches of all columns
LETTERS_POINTS = 5.5  # points of a name, at most
PER_INCH = 60.0  # points of a name that an inch has room for
DISTINGUISHED, ALIKE, UNDETECTED, SELF = 0, 1, 2, 3
COLOURS = ("#ffffff", DARK, LIGHT, "#777777")
HATCH = "////"  # of undetected causes, legible in greyscale
APART_CAPTION = (
    "Which causes the planned poses distinguish, if the cause of a row is present at its typical size. White: detected, and "
    "distinguished from the cause of the column, in 9 of 10 measurements. Dark: detected, but not distinguished. Hatched: not "
    "detected. Causes that lack a column or a figure of the robot have no row."
)


def apart_figure(table: pd.DataFrame) -> Figure:
    """Draw a matrix of causes and rivals: distinguished, not distinguished, or not detected."""
    tested = [row for row in from_frame(table, IsolabilityCell) if row.part]
    alone = [row for row in tested if not row.rival]
    names = [f"{row.cause} {row.joint}" if row.joint else f"{row.cause} ({row.part})" for row in alone]
    number = {(row.cause, row.part): k for k, row in enumerate(alone)}
    cells = np.full((len(names), len(names)), DISTINGUISHED)
    for row in tested:
        rival = number.get((row.rival, row.rival_part))
        if rival is not None and not row.enough:
            cells[number[row.cause, row.part], rival] = ALIKE
    undetected = [k for k, row in enumerate(alone) if not row.enough]
    cells[undetected] = UNDETECTED
    np.fill_diagonal(cells, SELF)

    high = float(np.clip(ROW * len(names), 1.0, HIGHEST))
    drawn, axes = chart(1.5 + high)
    edges = np.arange(len(names) + 1) - 0.5
    colours = ListedColormap(COLOURS)
    norm = BoundaryNorm(np.arange(5) - 0.5, 4)
    axes.pcolormesh(edges, edges, cells, cmap=colours, norm=norm, edgecolors="#cccccc", linewidth=0.3)
    for k in undetected:
        axes.axhspan(k - 0.5, k + 0.5, facecolor="none", edgecolor="#888888", hatch=HATCH, linewidth=0)
    axes.grid(False)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=min(LETTERS_POINTS, PER_INCH * WIDE / len(names)))
    axes.set_yticks(range(len(names)), names, fontsize=min(LETTERS_POINTS, PER_INCH * high / len(names)))
    axes.invert_yaxis()
    axes.set(xlabel="distinguished from", ylabel="if this is present")
    key = [
        Patch(facecolor=COLOURS[DISTINGUISHED], edgecolor="#888888", label="detected and distinguished"),
        Patch(facecolor=COLOURS[ALIKE], label="detected, not distinguished"),
        Patch(facecolor=COLOURS[UNDETECTED], edgecolor="#888888", hatch=HATCH, label="not detected"),
    ]
    drawn.legend(handles=key, ncols=3, loc="outside upper center")
    return drawn


def _isolability(material: Material) -> list[Block]:
    """Draw the matrix, and state each gap that can be filled."""
    table = material.tables[ISOLABILITY_TABLE]
    return [
        Paragraph(f"{first_up(isolability_summary(table))}. This is computed before measuring, from the model, the "
                  "device's noise and the tests of diagnose, for causes of typical size in any direction.", keep=True),
        Plot("isolability", apart_figure(table), APART_CAPTION, table),
        *(Paragraph(f"{first_up(words)}.") for words in isolability_gaps(table)),
        Paragraph(f"All probabilities, and the gaps that none of the additions fills, are in {ISOLABILITY_TABLE}."),
    ]  # fmt: skip


ISOLABILITY_SECTION = Section(71, "Which causes these poses distinguish", ISOLABILITY_TABLE, _isolability)
