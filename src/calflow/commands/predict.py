"""Where the calibrated robot will be."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OVER, apart, write_free
from calflow.commands.output import hand_over, say


@click.command()
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="ROWS.csv", type=FILE)
@click.option("--out", type=FILE, help="CSV to write; printed by default.")
@OVER
@click.option(
    "--without-conditions",
    is_flag=True,
    help="Predict rows that lack needed columns too, with a wider standard deviation.",
)
def predict(study_or_run: Path, rows: Path, out: Path | None, force: bool, without_conditions: bool) -> None:
    """Predict where the calibrated robot's markers will be at the joints and conditions of ROWS.csv.

    Give the run's folder, or its study.
    """
    from calflow.files.csv import csv_text
    from calflow.runs.predict import predict as predict_rows

    apart(out, "--out", rows)
    table = predict_rows(study_or_run, rows, "widen" if without_conditions else "refuse")
    for note in table.attrs["notes"]:
        say(f"note: {note}", err=True)
    if out is None:
        hand_over(csv_text(table))
    else:
        write_free(out, csv_text(table).encode(), force)
