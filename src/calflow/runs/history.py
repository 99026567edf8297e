"""The history of a robot by its runs, kept as tables and a report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from calflow.deployment.history import FALSE_ALARM, TABLES, History
from calflow.deployment.history import history as told_history
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.parameters import FittedParameter
from calflow.files.problems import InputError, Problem, refuse
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.compare import measured_files, run_names, same_robot
from calflow.runs.kept import keep


def history(*studies_or_runs: str | Path, false_alarm: float = FALSE_ALARM, out: str | Path | None = None) -> History:
    """Tell which parameters of one robot moved between its calibrations (see `deployment.history.history`).

    Args:
        studies_or_runs: the runs in the order in which they were measured, each named by its folder or its study.
        false_alarm: chance that anything is told where nothing moved.
        out: a folder for tables and report.pdf; None writes nothing.

    Raises:
        InputError: there are fewer than two, one has not identified yet, two are of the same measurements or of different
            robots, or the dates that their studies state are not in order.
    """
    if len(studies_or_runs) < 2:
        raise refuse("expected two runs or more, in order of time", key="runs")
    if not 1e-3 <= false_alarm <= 0.5:  # fewer alarms take more draws than are counted in
        raise refuse(f"expected 0.001 to 0.5, found {false_alarm:g}", key="false_alarm")
    runs = [CalibratedRun.of(one) for one in studies_or_runs]
    names = run_names(runs)
    dates = [run.file.acceptance.date if run.file.acceptance else None for run in runs]
    problems = [
        Problem(f"is of the same measurements as {names[a]}: its errors are the same, and tell nothing of time", runs[b].folder)
        for a, b in combinations(range(len(runs)), 2) if measured_files(runs[a]).keys() & measured_files(runs[b]).keys()
    ] + [
        Problem(f"is of another robot than {names[0]}", run.folder)
        for run in runs[1:] if same_robot(runs[0], run) == "another one"
    ]  # fmt: skip
    stated = [(date, run) for date, run in zip(dates, runs, strict=True) if date is not None]
    problems += [
        Problem(f"was measured on {later[0]}, before the run that is named before it ({earlier[0]})", later[1].folder)
        for earlier, later in pairwise(stated)
        if later[0] < earlier[0]
    ]
    if problems:
        raise InputError(problems)
    rng = np.random.default_rng(runs[0].file.seed)
    found = told_history(names, dates, [_with_what_is_left(run) for run in runs], false_alarm, rng)
    found = replace(found, notes=(*found.notes, *_doubts(runs, names)))
    if out is not None:
        from calflow.reporting.history_report import history_report

        title = runs[-1].file.title or runs[-1].robot.name
        keep(Path(out), found.results, TABLES, title, lambda: history_report(found, title))
    return found


def _with_what_is_left(run: CalibratedRun) -> CalibratedModel:
    """A run's model, its covariance as wide as its table says: after diagnose with what may be left in errors that rows share."""
    known = run.known(())
    stated = {one.parameter: one.sd for one in run.results.rows(f"{run.stage}/parameters.csv", FittedParameter)}
    sd = np.array([stated.get(one.name, np.nan) for one in known.model.parameters])
    own = np.sqrt(np.diag(known.covariance))
    wider = np.where(sd > own, sd / np.where(own > 0, own, 1.0), 1.0)
    return replace(known, covariance=known.covariance * np.outer(wider, wider))


def _doubts(runs: Sequence[CalibratedRun], names: Sequence[str]) -> Iterator[str]:
    """Say where what a model lacks may pass for a movement."""
    summaries = [run.results.document("identify/summary.json", IdentifySummary) for run in runs]
    doubtful = [
        name
        for name, run, one in zip(names, runs, summaries, strict=True)
        if run.stage != "diagnose" or one.discrepancy_mm > 0
    ]
    if doubtful:
        yield (
            f"the model of {', '.join(doubtful)} leaves errors beyond the noise, or was not diagnosed: where runs were measured at "
            "different poses such errors pass for movements; measure the same poses, and run diagnose"
        )
