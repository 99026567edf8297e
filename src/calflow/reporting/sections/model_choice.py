"""Model choice: the posterior probabilities of the models near the one found."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.diagnosis.cause_tables import ONLY, ModelRow
from calflow.effects.wording import cause_name, place_name
from calflow.files.words import first_up, listed, number
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import section

MODELS = "diagnose/models_in_reach.csv"
MODELS_SHOWN = 12  # causes and models in the tables, the most probable first
LEAST_PROBABILITY = 0.005  # of those shown
INTRODUCTION = (
    "Other models than the one found explain the data nearly as well: without some of its causes, with others in their places, or "
    "with one more. Their probabilities follow from the evidence, here relative to the model found, and from the prior that one "
    "cause of the whole catalogue is to be expected. They hold if one of these models is right."
)


@section(77, "Which causes: all models in reach", MODELS, lambda outcome: len(outcome.tables[MODELS]) > 0)
def model_choice_section(material: Material) -> list[Block]:
    """Tabulate the probability of each cause, and the most probable models."""
    models = material.models_in_reach
    causes = material.cause_probabilities
    shown = [row for row in causes if row.found or row.probability >= LEAST_PROBABILITY][:MODELS_SHOWN]
    found = next((_names(row) for row in models if row.change == "found"), [])
    likeliest = [_row(row, found) for row in models if row.probability >= LEAST_PROBABILITY][:MODELS_SHOWN]
    cells = [(first_up(place_name(row.cause, row.joint or 0, row.part)), f"{row.probability:.3f}") for row in shown]
    return [
        Paragraph(INTRODUCTION, keep=True),
        Table(("cause, in any of these models", "probability"), cells, "lr", wide=0),
        Table(("model, by what differs from the one found", "log evidence", "probability"), likeliest, "lrr", wide=0),
    ]


def _names(row: ModelRow) -> list[str]:
    return [
        place_name(cause, joint, part) if detail == ONLY else f"{cause_name(cause, joint)} ({detail})"
        for cause, joint, part, detail in zip(row.causes, row.joints, row.parts, row.details, strict=True)
    ]


def _row(row: ModelRow, found: Sequence[str]) -> tuple[str, str, str]:
    """Return a model's cells: the one found by its causes, any other by what it has more and less than that."""
    own = _names(row)
    more, less = [name for name in own if name not in found], [name for name in found if name not in own]
    changed = [f"{word} {listed(names)}" for word, names in (("with", more), ("without", less)) if names]
    model = "; ".join(changed) if row.change != "found" else f"as found: {listed(own) or 'no cause'}"
    return model, number(row.log_evidence, ".1f"), f"{row.probability:.3f}"
