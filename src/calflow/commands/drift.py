"""Whether anything has moved since the calibration, by a few check poses."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, NOT_TOLD, NOT_WELL, STATION, Command
from calflow.commands.output import say

if TYPE_CHECKING:
    from calflow.deployment.validation import Station

STATUS = {"moved": NOT_WELL, "cannot be told": NOT_TOLD}


@click.command(cls=Command)
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="NEW.csv", type=FILE)
@click.option(
    "--false-alarm", type=float, default=0.01, show_default=True, help="Chance of an alarm where nothing moved."
)
@STATION
@click.option(
    "--out", type=FILE, help="Folder for tables and report; drift/<name of NEW.csv> in the run folder by default."
)
def drift(study_or_run: Path, rows: Path, false_alarm: float, station: Station, out: Path | None) -> None:
    """Tell by five to ten check poses in NEW.csv whether anything has moved since the calibration, and what.

    Give the run's folder, or its study. Ends with 0 where nothing has moved, 3 where something has, and 4 where the poses are off
    but cannot tell why.
    """
    from calflow.files.writing import inside
    from calflow.reporting.drifted import drift_lines
    from calflow.runs.drift import drift as drift_of_run
    from calflow.runs.folder import run_folder

    folder = out or inside(run_folder(study_or_run), f"drift/{rows.stem}")
    found = drift_of_run(study_or_run, rows, false_alarm=false_alarm, station=station, out=folder)
    say(*drift_lines(found))
    for note in found.summary.notes:
        say(f"note: {note}", err=True)
    say(f"report: {folder / 'report.pdf'}")
    sys.exit(STATUS.get(found.summary.status, 0))
