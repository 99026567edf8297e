"""Commands that check a study before it runs, or a calibrated robot by new measurements."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import calflow as cf
from calflow.commands.console import (
    FALSE_ALARM,
    FILE,
    FOLDER,
    NEW_FILE,
    NUMBER,
    OVER,
    STATION,
    ArgumentCommand,
    cli,
    deliver,
    exit_code,
    say,
    say_notes,
)
from calflow.files.words import plural

if TYPE_CHECKING:
    from calflow.deployment.validation import Station
    from calflow.measurements.measurements import Measurements


@cli.command("check")
@click.argument("study", type=FILE)
def check_command(study: Path) -> None:
    """Check a study with its robot, workflow and measurements, and run nothing."""
    from calflow.runs.checking import check

    loaded = cf.load_study(study)
    checked = check(loaded)
    say(f"study {loaded.name}: {loaded.robot.name}, workflow {loaded.workflow.name} ({', '.join(loaded.stages)})")
    for far in loaded.all_to_fetch:
        say(f"{far.file} is not fetched yet: 'calflow run' fetches it from {far.url}")
    if checked is None and loaded.to_fetch:
        return
    if checked is None:
        say("no measurements yet: 'calflow run --stage select' proposes poses")
        return
    data = checked.data
    for doubt in checked.doubts:
        say(f"warning: {doubt.statement}")
    for note in data.notes:
        say(f"note: {note}")
    for k, path in enumerate(loaded.measurement_paths):
        say(_counted(path, data.only(data.of_series(k))))
    for fault in checked.faults:
        say(f"fault: {fault.summary}")
    source = "as the robot file says" if loaded.robot.base.known else "placed by the poses to fit"
    say(f"the nominal robot's error, base and tool {source}:")
    for row in checked.nominal.itertuples():
        say(f"  {row.split:8} mean {row.mean:.3f} {row.unit}, max {row.max:.3f} {row.unit}")
    say(f"{plural(checked.n_parameters, 'parameter')}: {', '.join(loaded.file.effects)}")
    for name, demand in checked.demands.items():
        if demand.words:
            say(f"{name} will take {demand.words}")
    for warning in checked.warnings:
        say(warning)
    unsettled = any(fault.action == "unsettled" for fault in checked.faults)
    first = "settle the mistake first: diagnose names no cause before"
    say(first if unsettled else f"not ok: {checked.far_off}" if checked.far_off else "ok")


def _counted(path: Path, data: Measurements) -> str:
    every, fitted = (table["pose"].nunique() for table in (data.table, data.table.loc[data.train]))
    return f"{path}: {plural(len(data), 'row')}, {plural(every, 'pose')}, {fitted} of them to fit"


@cli.command("check-poses", cls=ArgumentCommand)
@click.argument("study_or_run", type=FILE)
@click.argument("data", metavar="MEASURED.csv", type=FILE)
@click.option("--number", type=int, default=8, show_default=True, help="How many poses to choose.")
@click.option("--out", type=NEW_FILE, help="CSV to write; printed by default.")
@OVER
def check_poses_command(study_or_run: Path, data: Path, number: int, out: Path | None, force: bool) -> None:
    """Choose from the poses in MEASURED.csv those by which `calflow drift` can best tell what has moved.

    Give the run's folder, or its study. MEASURED.csv is the calibration's own file, or any other file of measured poses.
    """
    from calflow.files.tables import csv_text
    from calflow.reporting.drift_report import seen_from

    calibration = cf.Calibration.load(study_or_run)
    chosen = cf.choose_check_poses(calibration, cf.rows_measured(calibration, data), number)
    say(seen_from(chosen.foreseen), err=True)
    source = calibration.source
    deliver(csv_text(chosen.table, separator=source.separator, decimal=source.decimal), out, force)


@cli.command("validate", cls=ArgumentCommand)
@click.argument("study_or_run", type=FILE)
@click.argument("data", metavar="NEW.csv", type=FILE)
@click.option("--tolerance", type=NUMBER, help="As --tolerance-mm, in the unit of what was measured: px, mrad, N, …")
@click.option("--tolerance-mm", type=NUMBER, help="The largest error that a pose may have; asks for a verdict.")
@click.option(
    "--series",
    default="",
    help="Name or kind of the series that NEW.csv is of, if the study has several; by default the first that it fits.",
)
@click.option(
    "--task",
    type=int,
    help="How many further poses must all be within it (too hopeful where errors differ from pose to pose); one by default.",
)
@click.option("--confidence", type=NUMBER, default=0.95, show_default=True, help="Probability that 'met' needs.")
@STATION
@click.option(
    "--sent",
    type=click.Choice(["corrected commands", "program filter", "controller figures"]),
    help="What the robot had been given when it was measured; corrected commands where NEW.csv states targets.",
)
@click.option(
    "--out", type=FOLDER, help="Folder for tables and report; validate/<name of NEW.csv> in the run folder by default."
)
def validate_command(
    study_or_run: Path, data: Path, out: Path | None, tolerance_mm: float | None, tolerance: float | None, series: str,
    **asked: Any,
) -> None:  # fmt: skip
    """Validate the calibrated robot with NEW.csv, measurements to which it was not fitted.

    Give the run's folder, or its study. Exit code: 0 if the tolerance is met (or none is asked for), 3 if it is not, 4
    if these poses cannot tell.
    """
    from calflow.deployment.attained import unit_of
    from calflow.files.problems import refuse
    from calflow.files.writing import inside
    from calflow.reporting.validation_report import validation_report, verdict_lines
    from calflow.run_folder import run_folder
    from calflow.runs.kept import keep

    folder = out or inside(run_folder(study_or_run), f"validate/{data.stem}")
    calibration = cf.Calibration.load(study_or_run)
    measured = cf.rows_measured(calibration, data, series)
    unit = unit_of(measured)
    if tolerance is not None and tolerance_mm is not None:
        raise refuse("is stated twice: expected this or --tolerance", key="tolerance")
    if tolerance_mm is not None and unit.label != "mm":
        raise refuse(f"these rows are judged in {unit.label}: expected --tolerance in that unit", key="tolerance")
    shown = tolerance if tolerance_mm is None else tolerance_mm
    validation = calibration.validate(measured, tolerance=None if shown is None else shown / unit.scale, **asked)
    title = calibration.title
    keep(folder, validation, title, lambda: validation_report(validation, title, data.name))
    say(*verdict_lines(validation))
    say_notes(validation.summary.notes)
    say(f"report: {folder / 'report.pdf'}")
    sys.exit(exit_code(validation.summary.status))


@cli.command("drift", cls=ArgumentCommand)
@click.argument("study_or_run", type=FILE)
@click.argument("data", metavar="NEW.csv", type=FILE)
@FALSE_ALARM
@STATION
@click.option(
    "--out", type=FOLDER, help="Folder for tables and report; drift/<name of NEW.csv> in the run folder by default."
)
def drift_command(study_or_run: Path, data: Path, false_alarm: float, station: Station, out: Path | None) -> None:
    """Tell by five to ten check poses in NEW.csv whether anything has moved since the calibration, and what.

    Give the run's folder, or its study. Exit code: 0 if nothing has moved, 3 if something has, 4 if the poses are off
    but cannot tell why, 5 if nothing shows but hardly anything could.
    """
    from calflow.files.problems import refuse
    from calflow.files.writing import inside
    from calflow.reporting.advice import after_drift
    from calflow.reporting.drift_report import drift_lines, drift_report
    from calflow.run_folder import run_folder
    from calflow.runs.kept import keep

    if not 1e-3 <= false_alarm <= 0.5:  # a lower rate would need more random draws
        raise refuse(f"expected 0.001 to 0.5, found {false_alarm:g}", key="false_alarm")
    folder = out or inside(run_folder(study_or_run), f"drift/{data.stem}")
    calibration = cf.Calibration.load(study_or_run)
    measured = cf.rows_measured(calibration, data)
    result = cf.drift(calibration, measured, false_alarm=false_alarm, station=station, seed=calibration.seed)
    title = calibration.title
    keep(folder, result, title, lambda: drift_report(result, title, data.name))
    say(*drift_lines(result), after_drift(result))
    say_notes(result.summary.notes)
    say(f"report: {folder / 'report.pdf'}")
    sys.exit(exit_code(result.summary.status))
