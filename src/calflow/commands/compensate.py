"""Joint commands that land on targets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, OVER, apart, write_free
from calflow.commands.output import hand_over, say

if TYPE_CHECKING:
    import pandas as pd


@click.command()
@click.argument("study_or_run", type=FILE)
@click.argument("targets", metavar="TARGETS.csv", type=FILE)
@click.option("--out", type=FILE, help="CSV to write; printed by default.")
@OVER
@click.option(
    "--frames", type=FILE, help="TOML file of the frames that a column 'frame' names, besides measuring and base."
)
@click.option(
    "--in-order",
    is_flag=True,
    help="The robot goes from row to row: the side from which each joint comes follows from the commands.",
)
@click.option(
    "--without-conditions",
    is_flag=True,
    help="Do rows that lack needed columns too, with a wider standard deviation.",
)
def compensate(
    study_or_run: Path, targets: Path, out: Path | None, force: bool, frames: Path | None, in_order: bool,
    without_conditions: bool,
) -> None:  # fmt: skip
    """Work out joint commands with which the real robot lands on the targets of TARGETS.csv.

    Give the run's folder, or its study.
    """
    from calflow.files.csv import csv_text
    from calflow.runs.compensate import compensate as compensate_targets

    apart(out, "--out", targets)
    table = compensate_targets(
        study_or_run, targets, frames=frames, in_order=in_order, missing="widen" if without_conditions else "refuse"
    )
    for note in table.attrs["notes"]:
        say(f"note: {note}", err=True)
    if out is None:
        hand_over(csv_text(table))
        return
    write_free(out, csv_text(table).encode(), force)
    landed = table[table["reached"]]
    say(f"{len(landed)} of {len(table)} targets reached")
    if len(landed):
        say(
            f"distance from the target, root mean square: {_rms(landed['nominal_miss_mm']):.3f} mm with nominal commands, "
            f"{_rms(landed['expected_mm']):.3f} mm expected with these"
        )


def _rms(values: pd.Series) -> float:
    return float((values**2).mean() ** 0.5)
