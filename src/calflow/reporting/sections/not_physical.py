"""The section on the residual field: a correction that is not physical, what it gains, and where it ends."""

from __future__ import annotations

from calflow.estimation.residual_field import SUMMARY, FieldAccuracy, FieldSummary
from calflow.files.words import first_up
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

ACCURACY = "residual_field/accuracy.csv"
MEANING = (
    "The study asks for a smooth function of the joint readings that takes away what the model leaves and no cause explains. It is "
    "not physical: it says nothing of the robot, holds for this tool and these payloads alone, and beyond the measured range of "
    "any joint fades to nothing."
)
WHERE_APPLIED = (
    "Predictions and commands of calflow predict, compensate, filter and validate have it, with its own standard deviation, which "
    "rises to what was left without it where nothing was measured. Every other page of this report, and what calflow export and "
    "drift make, is without it."
)


def write(material: Material) -> list[Block]:
    """Say what it is and show what it gains at poses that it has not seen."""
    told = material.results.document(SUMMARY, FieldSummary)
    rows = [
        (one.correction, one.where, str(one.n), f"{one.mean_mm:.3f}", f"{one.rms_mm:.3f}", f"{one.max_mm:.3f}",
         "–" if one.covered is None else f"{100 * one.covered:.0f} %")
        for one in material.results.rows(ACCURACY, FieldAccuracy)
    ]  # fmt: skip
    header = ("correction", "where", "n", "mean [mm]", "rms [mm]", "max [mm]", "in 95 % interval")
    return [
        Paragraph(MEANING, keep=True),
        Paragraph(f"{first_up(told.statement)}.", bold=True),
        *([Table(header, rows, "llrrrrr", wide=0)] if rows else []),
        *([Paragraph(WHERE_APPLIED)] if told.applied else []),
    ]


SECTION = Section(16, "A correction that is not physical", (SUMMARY, ACCURACY), write)
