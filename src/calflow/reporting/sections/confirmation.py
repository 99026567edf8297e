"""Confirmation: the joint errors found, compared with those fitted to an independent series of measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from calflow.diagnosis.replication import CarriedAccuracy, ConfirmedCause
from calflow.files.deferred import pd
from calflow.files.words import mm, number
from calflow.reporting.blocks import Block, Paragraph, Plot, Table
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.style import ACCENT, DARK, panels

COLUMNS = 3
FAULTS = "diagnose/confirmation_faults.csv"
INTRODUCTION = (
    "The same joint errors were fitted to another series of measurements alone, with its own geometry, and compared over the "
    "travel that both series cover. Offset, slope and first order are left out of the comparison: a joint's zero, the "
    "geometry and gravity imitate them in either series."
)
CAPTION = "Joint errors as found here (line) and on the other series alone (dashes), beyond their first order."


def two_series(curves: pd.DataFrame) -> Figure:
    """Draw each joint's error [µrad] against its angle [deg] by both series; a slide's in µm and mm."""
    groups = list(curves.groupby(["cause", "joint"], sort=False))
    rows = -(-len(groups) // COLUMNS)
    drawn, grid = panels(rows, COLUMNS, 1.9 * rows + 0.3)
    for axes, ((_, joint), curve) in zip(grid.flat, groups, strict=False):
        slides = (curve["travel_unit"] == "mm").all()
        axes.plot(curve["travel"], curve["here"], color=DARK, label="here")
        axes.plot(curve["travel"], curve["there"], color=ACCENT, linestyle="--", label="the other series")
        axes.set(title=f"joint {joint}", xlabel="position [mm]" if slides else "angle [deg]")
        if slides or axes in grid[:, 0]:
            axes.set_ylabel("error [µm]" if slides else "error [µrad]")
    for axes in list(grid.flat)[len(groups) :]:
        axes.set_visible(False)
    drawn.legend(*grid.flat[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return drawn


@section(57, "Confirmation by an independent series", "diagnose/confirmation.csv")
def confirmation_section(material: Material) -> list[Block]:
    """Tabulate and draw each joint's error by both series, and state the model's error on the other series."""
    curves = material.tables["diagnose/confirmation_curves.csv"]
    accuracy = material.results.rows("diagnose/confirmation_accuracy.csv", CarriedAccuracy)
    cells = [
        (f"joint {cause.joint}", number(cause.correlation, ".3f"), _cell(cause.rms_here, cause.error_unit),
         _cell(cause.rms_there, cause.error_unit), _cell(cause.common, cause.travel_unit), cause.words)
        for cause in material.results.rows("diagnose/confirmation.csv", ConfirmedCause)
    ]  # fmt: skip
    header = ("joint", "correlation", "RMS here [µrad]", "RMS there [µrad]", "common range [deg]", "result")
    blocks: list[Block] = [Paragraph(INTRODUCTION, keep=True), Table(header, cells, "lrrrrl", wide=5)]
    if len(curves):
        blocks.append(Plot("confirmation", two_series(curves), CAPTION, curves))
    return [*blocks, Paragraph(_carried(accuracy)), *_faults(material.tables.get(FAULTS))]


def _faults(faults: pd.DataFrame | None) -> list[Block]:
    """Return the faults of the other series' file, which were dealt with before its fit."""
    if faults is None or faults.empty:
        return []
    statements = "; ".join(dict.fromkeys(faults["statement"]))
    return [Paragraph(f"In the other series' file, before it was fitted: {statements}. Correct that file too.")]


def _carried(accuracy: Sequence[CarriedAccuracy]) -> str:
    n = accuracy[0].n
    if n == 0:
        return (
            "The model as a whole was not tested: no held-out row of the other series lies within the ranges in which all "
            "these joint errors were found."
        )
    parts = [f"{mm(carried.heldout_mean_mm)} mm {carried.model}" for carried in accuracy]
    return f"At the {n} held-out rows of the other series within the travel covered here the mean error is {', '.join(parts)}."


def _cell(figure: float, unit: str) -> str:
    """Return a figure, of a slide with its unit, which is another than the column's."""
    slide = {"um": " µm", "mm": " mm"}.get(unit, "") if math.isfinite(figure) else ""
    return number(figure, ".0f") + slide
