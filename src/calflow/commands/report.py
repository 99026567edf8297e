"""The report, written anew."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OUT, resumable
from calflow.commands.output import say
from calflow.commands.progress import progress


@click.command()
@click.argument("study_or_run", type=FILE)
@OUT
def report(study_or_run: Path, out: Path | None) -> None:
    """Write the report of a run's results anew: give its folder, or its study."""
    from calflow.runs.folder import study_and_folder
    from calflow.runs.run import run as run_study

    study, folder = study_and_folder(study_or_run, out)
    with resumable(), progress() as listener:
        result = run_study(study, folder, "report", True, listener)
    say(f"report: {result.folder / 'report.pdf'}")
