"""Validation of a run by a file that was measured after it, kept as tables and a report."""

from __future__ import annotations

from pathlib import Path

from calflow.deployment.validation import CONFIDENCE, TABLES, Station, Validation
from calflow.deployment.validation import validate as validated
from calflow.files.problems import refuse
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.kept import keep
from calflow.runs.new_measurements import read_new


def validate(
    study_or_run: str | Path,
    rows: str | Path,
    *,
    tolerance: float | None = None,
    task: int | None = None,
    confidence: float = CONFIDENCE,
    station: Station = "auto",
    out: str | Path | None = None,
) -> Validation:
    """Hold a run's calibrated robot against new measurements (see `deployment.validation.validate`).

    Args:
        study_or_run: the run's folder, or its study.
        rows: a CSV of measurements that the run has not seen.
        tolerance: what a pose may err by [m].
        task: how many poses must all be within.
        confidence: the probability that a verdict "met" needs.
        station: auto, known or fitted.
        out: a folder for tables and report.pdf; None writes nothing.

    Raises:
        InputError: the run has not identified yet, or the rows or figures are at fault.
    """
    if tolerance is not None and not 0 < tolerance < 1:
        raise refuse(f"expected more than 0 and less than 1000 mm, found {1e3 * tolerance:g}", key="tolerance")
    if not 0.5 <= confidence < 1:
        raise refuse(f"expected at least 0.5 and less than 1, found {confidence:g}", key="confidence")
    if task is not None and task < 1:
        raise refuse(f"expected at least one pose, found {task}", key="task")
    run = CalibratedRun.of(study_or_run)
    data = read_new(run, rows)
    found = validated(
        run.known(data.given), run.needed, data, tolerance=tolerance, task=task, confidence=confidence, station=station
    )
    if out is not None:
        from calflow.reporting.validation_report import validation_report

        title = run.file.title or run.file.name
        keep(Path(out), found.results, TABLES, title, lambda: validation_report(found, title, Path(rows).name))
    return found
