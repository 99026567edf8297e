"""Isolability: which causes the planned poses detect and distinguish, and how gaps could be filled."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from matplotlib.figure import Figure

from calflow.design.discrimination import ENOUGH
from calflow.design.isolability import IsolabilityCell, isolability_gaps, isolability_summary
from calflow.effects.wording import place_name, place_names
from calflow.files.tables import from_frame
from calflow.files.words import first_up, plural
from calflow.reporting.advice import ISOLABILITY_TABLE
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.style import DARK, LIGHT, MIDDLE, chart

ROW, AROUND = 0.155, 0.55  # inches per cause, and of the axis below them
MOST = 40  # causes in the figure: a page
NEAR_CAPTION = (
    "Causes that the planned poses detect but do not distinguish from all others, each with the cause that is most like it: in "
    "how many of 100 measurements the two are distinguished if the first is present at its typical size. Dotted: enough."
)


def near_rivals(cells: Sequence[IsolabilityCell]) -> list[list[IsolabilityCell]]:
    """Return, for each detected cause that is not distinguished from all others, those it is not, the least distinguished first.

    The causes are in the order of their least distinguished ones.
    """
    detected = {(cell.cause, cell.part) for cell in cells if not cell.rival and cell.enough}
    pairs = [cell for cell in cells if cell.rival and not cell.enough and (cell.cause, cell.part) in detected]
    of_causes = groupby(pairs, lambda cell: (cell.cause, cell.part))
    near = [sorted(rivals, key=lambda cell: cell.chance) for _, rivals in of_causes]
    return sorted(near, key=lambda rivals: rivals[0].chance)


def near_figure(near: Sequence[Sequence[IsolabilityCell]]) -> Figure:
    """Draw how often each cause is distinguished from its nearest rival, which stands on the right with how many more there are."""
    drawn, axes = chart(AROUND + ROW * max(4, len(near)))
    chances = [100 * first.chance for first, *_ in near]
    axes.hlines(range(len(near)), 0, chances, color=LIGHT, linewidth=2)
    axes.plot(chances, range(len(near)), "o", color=DARK, clip_on=False)
    axes.axvline(100 * ENOUGH, color=MIDDLE, linestyle=":")
    axes.set_yticks(range(len(near)), [place_name(first.cause, first.joint, first.part) for first, *_ in near])
    rivals = axes.secondary_yaxis("right")
    rivals.set_yticks(
        range(len(near)),
        [
            place_name(first.rival, first.rival_joint, first.rival_part) + (f" and {len(more)} more" if more else "")
            for first, *more in near
        ],
    )
    for axis in (axes, rivals):
        axis.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.set(xlim=(0, 100), ylim=(len(near) - 0.5, -0.5), xlabel="distinguished in … of 100 measurements")
    return drawn


@section(71, "Which causes these poses distinguish", ISOLABILITY_TABLE)
def isolability_section(material: Material) -> list[Block]:
    """Draw the causes that have a near rival, name those that are not detected, and state each gap that can be filled."""
    table = material.tables[ISOLABILITY_TABLE]
    cells = [cell for cell in from_frame(table, IsolabilityCell) if cell.part]
    near, left = near_rivals(cells), ""
    if further := len(near[MOST:]):
        left = f" Besides {plural(further, 'cause')} of the table, which are distinguished more often."
    unseen = groupby((cell for cell in cells if not cell.rival and not cell.enough), lambda cell: cell.cause)
    names = [place_names(cause, [(cell.joint, cell.part) for cell in places]) for cause, places in unseen]
    return [
        Paragraph(f"{first_up(isolability_summary(table))}. This is computed before measuring, from the model, the "
                  "device's noise and the tests of diagnose, for causes of typical size in any direction.", keep=True),
        *([Plot("isolability", near_figure(near[:MOST]), NEAR_CAPTION + left, table)] if near else []),
        *([Paragraph(f"Not detected at this size: {'; '.join(names)}.")] if names else []),
        *(Paragraph(f"{first_up(words)}.") for words in isolability_gaps(table)),
        Paragraph(f"All probabilities, and the gaps that none of the additions fills, are in {ISOLABILITY_TABLE}."),
    ]  # fmt: skip
