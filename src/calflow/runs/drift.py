"""Drift of a run's robot by a few check poses, kept as tables and a report."""

from __future__ import annotations

from pathlib import Path

from calflow.deployment.drift import TABLES, Drift
from calflow.deployment.drift import drift as found_drift
from calflow.deployment.movements import FALSE_ALARM
from calflow.deployment.validation import Station
from calflow.files.problems import refuse
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.kept import keep
from calflow.runs.new_measurements import read_new


def drift(
    study_or_run: str | Path,
    rows: str | Path,
    *,
    false_alarm: float = FALSE_ALARM,
    station: Station = "auto",
    out: str | Path | None = None,
) -> Drift:
    """Tell whether anything has moved since a run calibrated its robot (see `deployment.drift_verdict.drift`).

    Args:
        study_or_run: the run's folder, or its study.
        rows: a CSV of check poses, measured once or at several dates (a column session, or time_s).
        false_alarm: chance that anything is told where nothing moved.
        station: auto, known or fitted.
        out: a folder for tables and report.pdf; None writes nothing.

    Raises:
        InputError: the run has not identified yet, or the rows or figures are at fault.
    """
    if not 1e-3 <= false_alarm <= 0.5:  # fewer alarms take more draws than are counted in
        raise refuse(f"expected 0.001 to 0.5, found {false_alarm:g}", key="false_alarm")
    run = CalibratedRun.of(study_or_run)
    data = read_new(run, rows)
    found = found_drift(
        run.known(data.given), run.needed, data, false_alarm=false_alarm, station=station, seed=run.file.seed
    )
    if out is not None:
        from calflow.reporting.drift_report import drift_report

        title = run.file.title or run.file.name
        keep(Path(out), found.results, TABLES, title, lambda: drift_report(found, title, Path(rows).name))
    return found
