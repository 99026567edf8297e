"""The section on predictions: do held-out errors lie where the posterior says they should."""

from __future__ import annotations

import pandas as pd
from scipy.stats import binom

from calflow.files.results import Results
from calflow.files.words import percent
from calflow.reporting.blocks import Block, Paragraph, Plot
from calflow.reporting.figures.chains import predictions
from calflow.reporting.material import Material
from calflow.reporting.section import Advice, Section

HELD_OUT = "held-out rows"
LEVEL = 0.95
SURPRISE = 0.01  # probability below which a coverage is not chance


def write(material: Material) -> list[Block]:
    """Draw held-out errors with their intervals and count how many lie inside."""
    rows, words = _judged(material.results)
    error, low, high = rows[["error_mm", "low_mm", "high_mm"]].to_numpy(dtype=float).T
    drawn = predictions(error, low, high, rows["covered"].to_numpy(dtype=bool))
    return [
        Paragraph(f"The model predicts how large each error should be. {coverage_words(material.results)}", keep=True),
        Plot("predictions", drawn, f"Errors of {words} against the interval in which each was expected (95 %).", rows),
    ]


def coverage_words(results: Results) -> str:
    """Say how many errors lie inside their interval."""
    rows, words = _judged(results)
    inside = int(rows["covered"].astype(bool).sum())
    return f"{inside} of {len(rows)} errors of {words} ({percent(inside / len(rows))}) lie inside their 95 % interval."


def _judged(results: Results) -> tuple[pd.DataFrame, str]:
    rows = results.tables["sample/predictive.csv"]
    held = rows[rows["split"] == "holdout"]
    return (held, HELD_OUT) if len(held) else (rows[rows["split"] == "train"], "rows used for the fit")


def too_narrow(results: Results) -> list[Advice]:
    """Intervals that miss more held-out errors than chance allows promise too much."""
    rows, words = _judged(results)
    inside = int(rows["covered"].astype(bool).sum())
    if words != HELD_OUT or binom.cdf(inside, len(rows), LEVEL) > SURPRISE:
        return []
    sentence = (
        f"Only {inside} of {len(rows)} held-out errors lie inside their 95 % interval: the standard deviations promise too "
        "much. Something varies that the model or the training poses lack."
    )
    return [Advice(2, sentence)]


SECTION = Section(80, "Predictions put to the test", ("sample/predictive.csv",), write, (too_narrow,))
