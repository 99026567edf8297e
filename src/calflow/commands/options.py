"""Arguments and options that several commands have."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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


def check_free(path: Path, content: bytes, force: bool) -> None:
    """Check that what is to be written does not write over a file that holds something else, unless that is forced.

    Raises:
        InputError: it would.
    """
    from calflow.files.problems import refuse

    if not force and path.exists() and (path.is_dir() or path.read_bytes() != content):
        raise refuse("is there already and holds something else; give --force to write over it, or --out", path)


@contextmanager
def resumable() -> Iterator[None]:
    """Have trouble of the machine tell that the same command goes on where it stopped."""
    try:
        yield
    except OSError as error:
        error.add_note("Finished stages are kept; when this is mended the same command goes on.")
        raise
