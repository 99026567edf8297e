"""The calibrated robot for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, OVER, write_free
from calflow.commands.output import hand_over, say

if TYPE_CHECKING:
    from calflow.deployment.export import Format


@click.command()
@click.argument("study_or_run", type=FILE)
@click.option(
    "--to",
    type=click.Choice(["urdf", "xacro-properties", "dh", "json", "controller"]),
    required=True,
    help="urdf; xacro-properties (origins alone); dh (a robot file); json; controller (a CSV of figures to type in).",
)
@click.option("--out", type=FILE, help="File to write; printed by default.")
@OVER
def export(study_or_run: Path, to: Format, out: Path | None, force: bool) -> None:
    """Write the calibrated robot for other programs, and say what their format cannot hold.

    Give the run's folder, or its study.
    """
    from calflow.runs.export import export_run

    found = export_run(study_or_run, to)
    for note in found.notes:
        say(f"note: {note}", err=True)
    if out is None:
        hand_over(found.text)
    else:
        write_free(out, found.text.encode(), force)
