"""A robot over time, by its calibrations."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from calflow.commands.options import FILE, NOT_TOLD, NOT_WELL, Command
from calflow.commands.output import say

STATUS = {"moved": NOT_WELL, "cannot be told": NOT_TOLD}


@click.command(cls=Command)
@click.argument("runs", metavar="RUN RUN…", type=FILE, nargs=-1, required=True)
@click.option(
    "--false-alarm", type=float, default=0.01, show_default=True, help="Chance of an alarm where nothing moved."
)
@click.option("--out", type=FILE, help="Folder for tables and report; nothing is kept by default.")
def history(runs: tuple[Path, ...], false_alarm: float, out: Path | None) -> None:
    """Tell which parameters of one robot moved between its calibrations, when, by how much, and what to recalibrate.

    Give runs of independent measurements in order of time. Ends with 0 where nothing has moved, 3 where something has, and 4 where
    something has but the runs do not tell what.
    """
    from calflow.reporting.over_time import history_lines
    from calflow.runs.history import history as history_of_runs

    found = history_of_runs(*runs, false_alarm=false_alarm, out=out)
    say(*history_lines(found))
    for note in found.notes:
        say(f"note: {note}", err=True)
    if out is not None:
        say(f"report: {out / 'report.pdf'}")
    sys.exit(STATUS.get(found.status, 0))
