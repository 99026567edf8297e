"""Model choice: all models in reach of what was found, each as probable as its evidence makes it."""

from __future__ import annotations

from calflow.diagnosis.verdict import ONLY, ModelRow
from calflow.effects.base import cause_name, place_name
from calflow.files.words import first_up, number
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

MODELS = "diagnose/models_in_reach.csv"
MODELS_SHOWN, LEAST_PROBABILITY = (
    12,
    0.005,
)  # causes and models that are told: those that are likeliest, down to this probability
INTRODUCTION = (
    "Other models than the one found explain the data nearly as well: without some of its causes, with others in their places, or "
    "with one more. Each is weighed by how probable it makes the data, and by what was assumed beforehand: one cause of the whole "
    "catalogue is to be expected. The probabilities hold if one of these models is right."
)


def _model_choice(material: Material) -> list[Block]:
    """Tabulate how probable each cause is, and the likeliest models."""
    models = material.models_in_reach
    causes = material.cause_probabilities
    shown = [row for row in causes if row.found or row.probability >= LEAST_PROBABILITY][:MODELS_SHOWN]
    likeliest = [_row(row) for row in models if row.probability >= LEAST_PROBABILITY][:MODELS_SHOWN]
    cells = [(first_up(place_name(row.cause, row.joint or 0, row.part)), f"{row.probability:.3f}") for row in shown]
    return [
        Paragraph(INTRODUCTION, keep=True),
        Table(("cause, in whatever form and beside whatever else", "probability"), cells, "lr", wide=0),
        Table(("model", "log evidence", "probability"), likeliest, "lrr", wide=0),
    ]


def _row(row: ModelRow) -> tuple[str, str, str]:
    named = [
        place_name(cause, joint, part) if detail == ONLY else f"{cause_name(cause, joint)} ({detail})"
        for cause, joint, part, detail in zip(row.causes, row.joints, row.parts, row.details, strict=True)
    ]
    words = {"found": " (as found)"}.get(row.change, "")
    return ", ".join(named or ["none of them"]) + words, number(row.log_evidence, ".1f"), f"{row.probability:.3f}"


MODEL_CHOICE_SECTION = Section(
    77, "Which causes: all models in reach", MODELS, _model_choice, lambda outcome: len(outcome.tables[MODELS]) > 0
)
