"""Runs side by side."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE
from calflow.commands.output import say


@click.command()
@click.argument("runs", metavar="RUN RUN…", type=FILE, nargs=-1, required=True)
@click.option("--out", type=FILE, help="Folder for tables and report; nothing is kept by default.")
def compare(runs: tuple[Path, ...], out: Path | None) -> None:
    """Compare runs: settings, data, parameters with the significance of their difference, accuracy and causes."""
    from calflow.reporting.compared import comparison_lines
    from calflow.runs.compare import compare as compare_runs

    found = compare_runs(*runs, out=out)
    say(*comparison_lines(found))
    if out is not None:
        say(f"report: {out / 'report.pdf'}")
