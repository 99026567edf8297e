"""A new study."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE
from calflow.commands.output import say


def _list(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if not asked:
        return
    from calflow.templates import library

    for name, said in library.listing():
        say(f"{name:20} {said}")
    context.exit()


@click.command()
@click.argument("folder", type=FILE)
@click.option(
    "--robot", default="", metavar="NAME|FILE.urdf", help="A robot of the library, or a URDF, which is copied."
)
@click.option("--tip", help="Of a URDF: the link that is the flange.")
@click.option("--base", help="Of a URDF: the link that stands on the floor; the root unless given.")
@click.option(
    "--list-robots", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="Show the library."
)
def new(folder: Path, robot: str, tip: str | None, base: str | None) -> None:
    """Write a new study into FOLDER, to be filled in."""
    from calflow.api.file_schemas import schema_text
    from calflow.files.writing import write_whole
    from calflow.templates import SCHEMAS, schema_kinds, schema_path, write_study

    for path in write_study(folder, robot, tip, base):
        say(f"wrote {path}")
    for kind in schema_kinds(robot).values():
        write_whole(folder / schema_path(kind), schema_text(kind).encode())
    doing = "look over" if robot else "describe your robot in"
    say(
        f"next: {doing} {folder / 'robot.toml'}, put the measurements into "
        f"{folder / 'measurements.csv'}, then: calflow check {folder}"
    )
    say(f"to try it with simulated measurements first: calflow simulate {folder / 'truth.toml'}")
    say(f"editors complete and check these files by {folder / SCHEMAS}")
