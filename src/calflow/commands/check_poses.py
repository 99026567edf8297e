"""Which few poses to check a robot by."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OVER, Command, write_free
from calflow.commands.output import hand_over, say


@click.command("check-poses", cls=Command)
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="MEASURED.csv", type=FILE)
@click.option("--number", type=int, default=8, show_default=True, help="How many poses to choose.")
@click.option("--out", type=FILE, help="CSV to write; printed by default.")
@OVER
def check_poses(study_or_run: Path, rows: Path, number: int, out: Path | None, force: bool) -> None:
    """Choose of the poses in MEASURED.csv those by which `calflow drift` tells best what has moved.

    Give the run's folder, or its study. MEASURED.csv is the calibration's own file, or any of poses that were measured.
    """
    from calflow.files.csv import csv_text
    from calflow.reporting.drifted import seen_from
    from calflow.runs.check_poses import choose_check_poses

    chosen = choose_check_poses(study_or_run, rows, number)
    say(seen_from(chosen.foreseen), err=True)
    if out is None:
        hand_over(csv_text(chosen.table))
    else:
        write_free(out, csv_text(chosen.table).encode(), force)
