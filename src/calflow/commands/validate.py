"""Whether the calibrated robot is where it should be, on new measurements."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, NOT_TOLD, NOT_WELL, STATION, Command
from calflow.commands.output import say

if TYPE_CHECKING:
    from calflow.deployment.validation import Station

STATUS = {"not met": NOT_WELL, "cannot be told": NOT_TOLD}


@click.command(cls=Command)
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="NEW.csv", type=FILE)
@click.option("--tolerance-mm", type=float, help="What a pose may err by: asks for a verdict.")
@click.option(
    "--task",
    type=int,
    help="How many poses must all be within (too hopeful where errors differ by pose); a further pose by default.",
)
@click.option("--confidence", type=float, default=0.95, show_default=True, help="Probability that 'met' needs.")
@STATION
@click.option(
    "--out", type=FILE, help="Folder for tables and report; validate/<name of NEW.csv> in the run folder by default."
)
def validate(
    study_or_run: Path,
    rows: Path,
    tolerance_mm: float | None,
    task: int | None,
    confidence: float,
    station: Station,
    out: Path | None,
) -> None:
    """Hold the calibrated robot against NEW.csv, measurements that it has not seen.

    Give the run's folder, or its study. Ends with 0 where the tolerance is met (or none is asked for), 3 where it is not, and 4
    where these poses cannot tell.
    """
    from calflow.files.writing import inside
    from calflow.reporting.proof import verdict_lines
    from calflow.runs.folder import run_folder
    from calflow.runs.validate import validate as validate_run

    folder = out or inside(run_folder(study_or_run), f"validate/{rows.stem}")
    tolerance = None if tolerance_mm is None else tolerance_mm / 1e3
    found = validate_run(
        study_or_run, rows, tolerance=tolerance, task=task, confidence=confidence, station=station, out=folder
    )
    say(*verdict_lines(found))
    for note in found.summary.notes:
        say(f"note: {note}", err=True)
    say(f"report: {folder / 'report.pdf'}")
    sys.exit(STATUS.get(found.summary.status, 0))
