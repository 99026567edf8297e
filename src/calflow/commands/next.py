"""The measuring loop: whether the measurements so far are enough, and which poses to measure next."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, NOT_TOLD, Command
from calflow.commands.output import say
from calflow.files.problems import seen

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table


@click.command("next", cls=Command)
@click.argument("study", type=FILE)
@click.option(
    "--rows", type=FILE, multiple=True, help="CSV of rows measured since, besides the study's own; may be repeated."
)
@click.option("--number", type=int, default=10, show_default=True, help="How many poses to propose.")
@click.option(
    "--tolerance-mm",
    type=float,
    help="What the tool's true error over the task is to be within; the study's by default.",
)
@click.option(
    "--probability", type=float, default=0.95, show_default=True, help="Of being within it, at which to stop."
)
@click.option("--out", type=FILE, help="Folder for poses.csv and verdict.json; nothing is written by default.")
def next_poses(
    study: Path, rows: tuple[Path, ...], number: int, tolerance_mm: float | None, probability: float, out: Path | None
) -> None:
    """Say after each batch of measurements whether they are enough, and which poses to measure next.

    Ends with 0 where the tolerance is met as surely as asked, or none is stated, and 4 where it is not yet. A run folder is neither
    read nor written.
    """
    from rich.console import Console

    from calflow.reporting.next_step import next_lines
    from calflow.runs.measured_since import with_rows
    from calflow.runs.next_poses import next_poses as of_study
    from calflow.study import load_study

    tolerance = None if tolerance_mm is None else tolerance_mm / 1e3
    trouble = Console(stderr=True, highlight=False, markup=False)
    with trouble.status("measured so far …"):
        measured = with_rows(load_study(study), rows)
        step = of_study(measured, number, tolerance, probability, say=lambda line: trouble.print(seen(line)))
    say(*next_lines(step.verdict))
    if len(step.poses):
        load = step.poses["payload"].iloc[0] or "no payload"
        say(f"measure next, with {load}, in this order:")
        Console(highlight=False, markup=False, soft_wrap=True).print(_table(step.poses))
    if out is not None:
        step.write(out)
        say(f"wrote {out / 'poses.csv'} and {out / 'verdict.json'}")
    sys.exit(
        NOT_TOLD
        if step.verdict.status in ("measure", "too few", "nothing measured") and step.verdict.tolerance_mm
        else 0
    )


def _table(poses: pd.DataFrame) -> Table:
    """The poses as a terminal shows them: readings and reason; the rest is in poses.csv."""
    from rich.box import SIMPLE
    from rich.table import Table

    readings = [str(name) for name in poses if str(name).startswith("q")]
    table = Table(box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("pose", *readings):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("what for", overflow="fold")
    for pose, *values, reason in poses[["pose", *readings, "reason"]].to_numpy(object):
        table.add_row(str(pose), *(f"{value:.2f}" for value in values), seen(reason))
    return table
