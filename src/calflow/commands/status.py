"""How far a run has come."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE
from calflow.commands.output import say


@click.command()
@click.argument("study_or_run", type=FILE)
def status(study_or_run: Path) -> None:
    """Show how far a run has come: give its folder, or its study."""
    from calflow.files.problems import refuse
    from calflow.runs.folder import run_folder
    from calflow.runs.manifest import read_manifest

    folder = run_folder(study_or_run)
    manifest = read_manifest(folder)
    if manifest is None:
        raise refuse("nothing was run here yet", folder)
    say(f"{folder}: study {manifest.study}, workflow {manifest.workflow}, calflow {manifest.calflow}")
    for name, entry in manifest.stages.items():
        seconds = "" if entry.seconds is None else f"{entry.seconds:.1f} s"
        reused = f"; reused since: {entry.reused}" if entry.reused else ""
        say(f"{name:14} {entry.status:12} {seconds:>8}  ran because: {entry.reason}{reused}")
