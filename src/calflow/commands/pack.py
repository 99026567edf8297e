"""A run in one archive."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, OVER, write_free
from calflow.commands.output import say


@click.command()
@click.argument("run", type=FILE)
@click.option("--out", type=FILE, help="Archive to write; RUN.zip beside the run folder by default.")
@click.option("--licence", default="", metavar="SPDX", help="Under which terms the files may be used, e.g. CC-BY-4.0.")
@click.option(
    "--author",
    multiple=True,
    metavar="NAME",
    help="Who made the measurements or the run; several times where several did.",
)
@OVER
def pack(run: Path, out: Path | None, licence: str, author: tuple[str, ...], force: bool) -> None:
    """Pack RUN, a run folder, with its inputs and versions into a zip that `calflow reproduce` repeats elsewhere, once unpacked.

    The archive is an RO-Crate.
    """
    from calflow.runs.pack import pack as pack_run
    from calflow.runs.terms import Terms

    terms = Terms(licence, author)
    write_free(out or Path(f"{run.resolve()}.zip"), pack_run(run, terms), force)
    if not licence:
        say(
            "no licence stated, so nobody can know who may use the files: state it by --licence, e.g. CC-BY-4.0",
            err=True,
        )
