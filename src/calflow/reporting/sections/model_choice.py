"""Model choice: all models in reach of what was found, each as probable as its evidence makes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calflow.diagnosis.models_in_reach import ONLY, CauseProbability, ModelRow
from calflow.effects.base import cause_name, place_name
from calflow.files.deferred import pd
from calflow.files.words import number
from calflow.reporting.blocks import Block, Paragraph, Plot, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, MIDDLE, figure

ROW = 0.2  # inches of a cause


def cause_probabilities(names: Sequence[str], probability: np.ndarray) -> Figure:
    """Draw each cause's probability (n_causes,)."""
    drawn = figure(0.9 + ROW * len(names))
    axes = drawn.subplots()
    place = np.arange(len(names))
    axes.hlines(place, 0, probability, color=MIDDLE, linewidth=0.8)
    axes.plot(probability, place, "o", color=DARK, clip_on=False)
    axes.set_yticks(place, names)
    axes.set(xlim=(0, 1), ylim=(len(names) - 0.4, -0.6), xlabel="probability that it acts")
    return drawn


SHOWN, LEAST = 12, 0.005  # causes and models that are told: those that are likeliest, down to this probability
INTRODUCTION = (
    "What was found is one model; others are near: without some of its causes, with others in their places, or with one more. "
    "Each is weighed by how probable it makes the rows, whatever the size of its causes, and by what was assumed beforehand: "
    "one cause of the whole catalogue is to be expected. The probabilities hold if one of these models is right."
)
CAUSES = "How probable it is that each cause acts, in whatever form and beside whatever else."


def _model_choice(material: Material) -> list[Block]:
    """Draw how probable each cause is, and list the likeliest models."""
    models = material.results.rows("diagnose/models_in_reach.csv", ModelRow)
    causes = material.results.rows("diagnose/cause_probabilities.csv", CauseProbability)
    shown = [row for row in causes if row.found or row.probability >= LEAST][:SHOWN]
    names = [place_name(row.cause, row.joint or 0, row.part) for row in shown]
    table = pd.DataFrame({"cause": names, "probability": [row.probability for row in shown]})
    drawn = cause_probabilities(names, table["probability"].to_numpy())
    return [
        Paragraph(INTRODUCTION, keep=True),
        Plot("cause_probabilities", drawn, CAUSES, table),
        Table(("model", "log evidence", "probability"), [_row(row) for row in models if row.probability >= LEAST][:SHOWN],
              "lrr", wide=0),
    ]  # fmt: skip


def _row(row: ModelRow) -> tuple[str, str, str]:
    named = [
        place_name(cause, joint, part) if detail == ONLY else f"{cause_name(cause, joint)} ({detail})"
        for cause, joint, part, detail in zip(row.causes, row.joints, row.parts, row.details, strict=True)
    ]
    words = {"found": " (as found)"}.get(row.change, "")
    return ", ".join(named or ["none of them"]) + words, number(row.log_evidence, ".1f"), f"{row.probability:.3f}"


MODEL_CHOICE_SECTION = Section(
    77,
    "Which causes: all models in reach",
    ("diagnose/models_in_reach.csv", "diagnose/cause_probabilities.csv"),
    _model_choice,
    worth_telling=lambda results: len(results.tables["diagnose/models_in_reach.csv"]) > 0,
)
