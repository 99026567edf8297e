"""Model choice: all models in reach of what was found, each as probable as its evidence makes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calflow.effects.cause import place_name
from calflow.files.words import number, percent
from calflow.reporting.blocks import Block, Paragraph, Plot, Table, listing
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import DARK, MIDDLE, figure
from calflow.sampling.models import ONLY, CauseProbability, ModelRow

ROW = 0.2  # inches of a cause


def cause_probabilities(names: Sequence[str], probability: np.ndarray, by_tests: np.ndarray) -> Figure:
    """Draw each cause's probability (n_causes,), and beside it what the tests of diagnose made it."""
    drawn = figure(0.9 + ROW * len(names))
    axes = drawn.subplots()
    place = np.arange(len(names))
    ends = np.sort([probability, by_tests], axis=0)
    axes.hlines(place, *ends, color=MIDDLE, linewidth=0.8)
    look: dict[str, Any] = {"color": DARK, "clip_on": False}
    axes.plot(by_tests, place, "o", markerfacecolor="white", label="by the linear tests of diagnose", **look)
    axes.plot(probability, place, "o", label="probability", **look)
    axes.set_yticks(place, names)
    axes.set(xlim=(0, 1), ylim=(len(names) - 0.4, -0.6), xlabel="probability that it acts")
    drawn.legend(ncols=2, loc="outside upper center")
    return drawn


SHOWN, LEAST = 12, 0.005  # causes and models that are told: those that are likeliest, down to this probability
FAR = 0.1  # by how much a probability differs from that of diagnose for it to be said
INTRODUCTION = (
    "What was found is one model; others are a step away: without one of its causes, with another in its place, or with one more. "
    "Each is fitted to the same rows, and its probability is that of these rows under it, all its parameters integrated out, times "
    "what was assumed before: that of the whole catalogue one cause is to be expected. All holds if one of these models is right."
)
SHARED = (
    "Errors of rows near each other, or of the markers of one pose, are not independent here. Probabilities that take them for it "
    "would be too sure, so these are the ones of the tests of diagnose, which count it."
)
CAUSES = (
    "How probable it is that each cause acts, in whatever form and beside whatever else. Filled: all parameters integrated "
    "out; open: by the linear tests of diagnose, for the same models."
)


def _model_choice(material: Material) -> list[Block]:
    """Draw how probable each cause is, and list the likeliest models."""
    models = material.results.rows("sample/models.csv", ModelRow)
    causes = material.results.rows("sample/cause_probabilities.csv", CauseProbability)
    shown = [row for row in causes if row.found or max(row.probability, row.by_tests) >= LEAST][:SHOWN]
    names = [place_name(row.cause, row.joint or 0, row.part) for row in shown]
    table = pd.DataFrame({"cause": names, "probability": [row.probability for row in shown],
                          "by_tests": [row.by_tests for row in shown]})  # fmt: skip
    drawn = cause_probabilities(names, table["probability"].to_numpy(), table["by_tests"].to_numpy())
    return [
        Paragraph(INTRODUCTION, keep=True),
        *([Paragraph(SHARED)] if pd.isna(models[0].log_evidence) else []),
        Plot("cause_probabilities", drawn, CAUSES, table),
        *listing(differing(shown)),
        Table(("model", "log evidence", "probability"), [_row(row) for row in models if row.probability >= LEAST][:SHOWN],
              "lrr", wide=0),
    ]  # fmt: skip


def differing(causes: list[CauseProbability]) -> list[str]:
    """Say where the tests of diagnose made a cause much more or less probable."""
    return [
        f"{place_name(row.cause, row.joint or 0, row.part)}: {percent(row.probability)}, where the linear tests say "
        f"{percent(row.by_tests)}. They go by one linearisation, with usual sizes and rarer ones; this one integrates over all "
        "sizes that bounds and priors allow."
        for row in causes
        if abs(row.probability - row.by_tests) > FAR
    ]


def _row(row: ModelRow) -> tuple[str, str, str]:
    named = [
        place_name(cause, joint, part) + (f" ({detail})" if detail != ONLY else "")
        for cause, joint, part, detail in zip(row.causes, row.joints, row.parts, row.details, strict=True)
    ]
    words = {"found": " (as found)"}.get(row.change, "")
    told = "–" if pd.isna(row.log_evidence) else number(row.log_evidence, ".1f")
    return ", ".join(named or ["none of them"]) + words, told, f"{row.probability:.3f}"


MODEL_CHOICE_SECTION = Section(
    77,
    "Which causes: all models in reach",
    ("sample/models.csv", "sample/cause_probabilities.csv"),
    _model_choice,
    worth_telling=lambda results: len(results.tables["sample/models.csv"]) > 0,
)
