"""Running a study."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, FORCE, OUT, STAGE, resumable
from calflow.commands.output import say
from calflow.commands.progress import progress


@click.command()
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def run(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Run a study: what did not change is reused, what was interrupted is resumed."""
    from calflow.reporting.last_lines import last_lines
    from calflow.runs.run import run as run_study
    from calflow.study import load_study

    with resumable(), progress() as listener:
        result = run_study(load_study(study), out, stage, force, listener)
    say(*last_lines(result.results))
    report = result.folder / "report.pdf"
    say(f"report: {report}" if report.is_file() else f"results: {result.folder}")
