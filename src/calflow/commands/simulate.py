"""Simulated measurements."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OVER, check_free
from calflow.commands.output import say


@click.command()
@click.argument("truth", type=FILE)
@click.option("--out", type=FILE, help="Measurement CSV; measurements.csv beside the truth file by default.")
@OVER
def simulate(truth: Path, out: Path | None, force: bool) -> None:
    """Write the measurements that a truth file describes."""
    from calflow.files.csv import csv_text, write_csv
    from calflow.simulation import simulate as simulate_truth

    path = out or truth.parent / "measurements.csv"
    table = simulate_truth(truth)
    check_free(path, csv_text(table).encode(), force)
    write_csv(path, table)
    say(f"wrote {path}")
