"""JSON Schemas of the files that a user writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE, OVER, write_free
from calflow.commands.output import hand_over

if TYPE_CHECKING:
    from calflow.api.file_schemas import Draft


@click.command()
@click.argument("kind", default="")
@click.option("--draft", type=click.Choice(["4", "2020-12"]), default="4", show_default=True,
              help="Of JSON Schema; editors' TOML support (Taplo) reads 4.")  # fmt: skip
@click.option("--out", type=FILE, help="File to write, a folder where no KIND is given; printed by default.")
@OVER
def schema(kind: str, draft: Draft, out: Path | None, force: bool) -> None:
    """Write the JSON Schema of a KIND of file (study, robot, urdf-robot, workflow, truth, frames, fleet); of all without KIND.

    A file whose first line is `#:schema PATH` is then completed and checked by editors, and by `taplo check`.
    """
    from calflow.api.file_schemas import KINDS, schema_text

    if not kind and out is None:
        raise click.UsageError(f"expected a KIND ({', '.join(KINDS)}), or --out FOLDER for all")
    for one in [kind] if kind else KINDS:
        said = schema_text(one, draft)
        if out is None:
            hand_over(said)
        else:
            write_free(out if kind else out / f"{one}.schema.json", said.encode(), force)
