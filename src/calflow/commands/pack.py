"""A run in one archive."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OVER, write_free


@click.command()
@click.argument("run", type=FILE)
@click.option("--out", type=FILE, help="Archive to write; RUN.zip beside the run folder by default.")
@OVER
def pack(run: Path, out: Path | None, force: bool) -> None:
    """Pack RUN, a run folder, with its inputs and versions into a zip that `calflow reproduce` repeats elsewhere, once unpacked.

    The archive is an RO-Crate.
    """
    from calflow.runs.pack import pack as pack_run

    write_free(out or Path(f"{run.resolve()}.zip"), pack_run(run), force)
