"""A finished run judged as its own report judges it, in the figures and words of an outcome."""

from __future__ import annotations

from calflow.deployment.usability import accuracy_steps, is_useless, split_judged
from calflow.files.results import Results
from calflow.fleet.outcome import Outcome
from calflow.reporting.material import findings
from calflow.reporting.sections.verdict import judgement


def judged(robot: str, type_: str, results: Results) -> Outcome:
    """Return the outcome of a run from its results, which have those of identify."""
    split = split_judged(results)
    steps = [row for row in accuracy_steps(results) if row.split == split]
    first, last = steps[0], steps[-1]
    return Outcome(
        robot=robot, type=type_, status="calibrated", usable=not is_useless(results), verdict=judgement(results),
        judged_by=split, points=last.n,
        before_mean_mm=first.mean_mm, before_max_mm=first.max_mm, after_mean_mm=last.mean_mm, after_max_mm=last.max_mm,
        causes=tuple(one.in_short for one in findings(results)),
    )  # fmt: skip
