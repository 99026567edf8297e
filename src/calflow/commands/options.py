"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path

import click

OUT = click.option("--out", type=click.Path(path_type=Path), help="Run folder; runs/<study name> by default.")
STAGE = click.option("--stage", help="This stage alone, with what it needs.")
FORCE = click.option("--force", is_flag=True, help="Do not reuse earlier results.")
FILE = click.Path(path_type=Path)
NOT_WELL, NOT_TOLD = 3, 4  # exit codes of a verdict that is against the robot, and of one that cannot be given
STATION = click.option(
    "--station",
    type=click.Choice(["auto", "known", "fitted"]),
    default="auto",
    show_default=True,
    help="Whether the device stood where it stood in the calibration.",
)


def apart(written: Path | None, option: str, *others: Path) -> None:
    """Check that a file that an option names is none of the others, which it would write over.

    Raises:
        UsageError: it is.
    """
    for other in others:
        if written is not None and written.resolve() == other.resolve():
            raise click.UsageError(f"{option} {written} would write over {other}: expected another file")
