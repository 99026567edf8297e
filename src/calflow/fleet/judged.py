"""A finished run judged as its own report judges it, in the figures and words of an outcome."""

from __future__ import annotations

from calflow.files.results import Results
from calflow.fleet.outcome import Outcome
from calflow.reporting.material import findings, latest, split_judged, steps
from calflow.reporting.sections.acceptance import useless
from calflow.reporting.sections.verdict import judgement


def judged(robot: str, type_: str, results: Results) -> Outcome:
    """Return the outcome of a run from its results, which have those of identify."""
    accuracy = latest(results, "accuracy")
    split = split_judged(accuracy)
    models = steps(accuracy, split)
    first, last = models[0], models[-1]
    return Outcome(
        robot=robot, type=type_, status="calibrated", usable=not useless(results, models), verdict=judgement(results, models),
        judged_by="holdout" if split == "holdout" else "train", points=last.n,
        before_mean_mm=first.mean, before_max_mm=first.max, after_mean_mm=last.mean, after_max_mm=last.max,
        causes=tuple(one.in_short for one in findings(results)),
    )  # fmt: skip
