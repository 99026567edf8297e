"""Commands before a study runs: new, simulate, next and schema."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

import calflow as cf
from calflow.commands.console import (
    FILE,
    FOLDER,
    NEW_FILE,
    NOT_TOLD,
    NUMBER,
    OVER,
    ArgumentCommand,
    check_unwritten,
    cli,
    hand_over,
    say,
    show_table,
    write_free,
)
from calflow.files.problems import escaped

if TYPE_CHECKING:
    from calflow.commands.file_schemas import Draft


def _list(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if not asked:
        return
    from calflow.templates import library_listing

    for name, description in library_listing():
        say(f"{name:20} {description}")
    context.exit()


@cli.command("new")
@click.argument("folder", type=FILE)
@click.option(
    "--robot",
    default="",
    metavar="NAME|FILE",
    help="A robot of the library or of robot_descriptions, or a URDF, which is copied, or MJCF, which is converted to one.",
)
@click.option(
    "--tip", multiple=True, help="Of a URDF or MJCF: the link that is the flange; once for each arm of a tree."
)
@click.option("--base", help="Of a URDF: the link that stands on the floor; the root unless given.")
@click.option(
    "--factory",
    type=FILE,
    help="Factory calibration of Universal Robots: calibration.conf, or the YAML of ur_calibration.",
)
@click.option(
    "--list-robots", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="Show the library."
)
def new_command(folder: Path, robot: str, tip: tuple[str, ...], base: str | None, factory: Path | None) -> None:
    """Write a new study into FOLDER, to be filled in."""
    from calflow.commands.file_schemas import schema_text
    from calflow.files.writing import write_whole
    from calflow.templates import SCHEMAS, schema_kinds, schema_path, write_study

    for path in write_study(folder, robot, tip, base, factory):
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


@cli.command("simulate")
@click.argument("truth", type=FILE)
@click.option("--out", type=NEW_FILE, help="Measurement CSV; measurements.csv beside the truth file by default.")
@OVER
def simulate_command(truth: Path, out: Path | None, force: bool) -> None:
    """Write the measurements that a truth file describes."""
    from calflow.files.tables import csv_text, write_csv

    path = out or truth.parent / "measurements.csv"
    table = cf.simulate(truth)
    check_unwritten(path, csv_text(table).encode(), force)
    write_csv(path, table)
    say(f"wrote {path}: simulated; state simulated = true under [acceptance] of its study, so that the report says so")


@cli.command("next", cls=ArgumentCommand)
@click.argument("study", type=FILE)
@click.option(
    "--rows", type=FILE, multiple=True, help="CSV of rows measured since, besides the study's own; may be repeated."
)
@click.option("--number", type=int, default=10, show_default=True, help="How many poses to propose.")
@click.option("--tolerance-mm", type=NUMBER, help="Of the tool's true error over the task; the study's by default.")
@click.option(
    "--probability", "confidence", type=NUMBER, default=0.95, show_default=True, help="Of meeting it, at which to stop."
)
@click.option("--out", type=FOLDER, help="Folder for poses.csv and verdict.json; nothing is written by default.")
def next_command(
    study: Path, rows: tuple[Path, ...], number: int, tolerance_mm: float | None, confidence: float, out: Path | None
) -> None:
    """Say after each batch of measurements whether they are enough, and which poses to measure next.

    Exit code: 0 if the tolerance is met as surely as asked, or none is stated, 4 if it is not met yet. A run folder is
    neither read nor written.
    """
    from rich.console import Console

    from calflow.design.next_poses import TABLES
    from calflow.reporting.terminal import next_lines
    from calflow.runs.given_rows import with_rows
    from calflow.runs.kept import keep_results

    tolerance = None if tolerance_mm is None else tolerance_mm / 1e3
    trouble = Console(stderr=True, highlight=False, markup=False)
    with trouble.status("measured so far …"):
        measured = with_rows(cf.load_study(study), rows)
        step = cf.next_poses(measured, number, tolerance, confidence, say=lambda line: trouble.print(escaped(line)))
    say(*next_lines(step.verdict))
    if len(step.poses):
        load = step.poses["payload"].iloc[0] or "no payload"
        say(f"measure next, with {load}, in this order:")
        readings = [str(name) for name in step.poses if str(name).startswith("q")]
        proposed = step.poses[["pose", *readings, "reason"]].to_numpy(object)
        cells = ((str(pose), *(f"{value:.2f}" for value in values), reason) for pose, *values, reason in proposed)
        show_table(cells, ("pose", *readings, "what for"), "pose", *readings)
    if out is not None:
        keep_results(out, step.results, TABLES, "Poses to measure next")
        say(f"wrote {out / 'poses.csv'} and {out / 'verdict.json'}")
    sys.exit(
        NOT_TOLD
        if step.verdict.status in ("measure", "too few", "nothing measured") and step.verdict.tolerance_mm
        else 0
    )


@cli.command("schema")
@click.argument("kind", default="")
@click.option("--draft", type=click.Choice(["4", "2020-12"]), default="4", show_default=True,
              help="Of JSON Schema; editors' TOML support (Taplo) reads 4.")  # fmt: skip
@click.option("--out", type=FILE, help="File to write, a folder where no KIND is given; printed by default.")
@OVER
def schema_command(kind: str, draft: Draft, out: Path | None, force: bool) -> None:
    """Write the JSON Schema of a KIND of file (study, robot, urdf-robot, workflow, truth, frames, fleet); of all without KIND.

    A file whose first line is `#:schema PATH` is then completed and checked by editors, and by `taplo check`.
    """
    from calflow.commands.file_schemas import SCHEMAS, schema_text

    if not kind and out is None:
        raise click.UsageError(f"expected a KIND ({', '.join(SCHEMAS)}), or --out FOLDER for all")
    for name in [kind] if kind else SCHEMAS:
        text = schema_text(name, draft)
        if out is None:
            hand_over(text)
        else:
            write_free(out if kind else out / f"{name}.schema.json", text.encode(), force)
