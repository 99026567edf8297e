"""The command import, which converts exports, spreadsheets and recordings to measurements."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import calflow as cf
from calflow.commands.console import FILE, FOLDER, NUMBER, cli, say, say_notes, show_table
from calflow.files.problems import Problem, escaped, refuse, refuse_any
from calflow.files.words import plural

if TYPE_CHECKING:
    from calflow.importing.proposal import ColumnOrigin

MEASURED, STUDY, ROBOT = "measurements.csv", "study.toml", "robot.toml"


@cli.command("import")
@click.argument("files", metavar="FILE…", type=FILE, nargs=-1, required=True)
@click.option("--robot", type=FILE, help="Robot file; by default robot.toml in the study's folder.")
@click.option("--into", type=FOLDER, default=Path("."), help="Folder of the study; the working folder by default.")
@click.option(
    "--column", "columns", multiple=True, metavar="OURS=NAME",
    help="What a column of the files is, if calflow cannot tell: q1_deg=A1, x_mm=Xist; q3_deg=-A3 counts the other way.",
)  # fmt: skip
@click.option(
    "--sigma-rotation-mrad",
    type=NUMBER,
    help="Standard deviation of measured orientations; without it they are left out.",
)
@click.option("--dry-run", is_flag=True, help="Show the mapping, and write nothing.")
def import_command(
    files: tuple[Path, ...],
    robot: Path | None,
    into: Path,
    columns: tuple[str, ...],
    sigma_rotation_mrad: float | None,
    dry_run: bool,
) -> None:
    """Look at exports, spreadsheets or recordings, propose which columns are joints and points, and write the measurements.

    Several files belong together: joints in one, points in the other, or one after the other. Order, unit and sign of
    the joints are those with which the robot is where the points were measured.
    """
    from calflow.files.tables import csv_text
    from calflow.files.writing import write_text
    from calflow.importing.proposal import propose_import, stated_columns

    described = robot or into / ROBOT
    if not described.exists():
        raise refuse(
            "no such robot file, by whose kinematics columns are recognised: name its study's folder with --into, or the file "
            "with --robot; calflow new writes one",
            described,
            key="--robot",
        )
    target, study = into / MEASURED, into / STUDY
    if not dry_run:
        written = "is there already; nothing was written: delete or rename it, or look first with --dry-run"
        refuse_any([Problem(written, target)] if target.exists() else [])
    maker = cf.Robot.from_toml(described)
    sigma = None if sigma_rotation_mrad is None else sigma_rotation_mrad / 1e3
    proposal = propose_import(files, maker, stated_columns(columns), sigma)
    mapping = ((origin.ours, origin.theirs or "–", origin.how, origin.reason) for origin in proposal.origins)
    show_table(mapping, ("column", "from", "how", "why"))
    say_notes(proposal.notes)
    poses = proposal.table["pose"].nunique()
    say(f"{plural(len(proposal.table), 'row')}, {plural(poses, 'pose')}")
    if dry_run:
        return
    write_text(target, csv_text(proposal.table))
    say(f"wrote {target}")
    comments = [f"# {line}" for line in _source_lines(files, proposal.origins)]
    if study.exists():
        if f'\nfile = "{MEASURED}"' not in study.read_text(encoding="utf-8", errors="replace"):
            say(f"{study} is as it was: it needs", "[measurements]", f'file = "{MEASURED}"')
    else:
        from calflow.templates import study_text

        text = study_text(into, maker, Path(os.path.relpath(described, into)).as_posix())
        write_text(study, text.replace(f'file = "{MEASURED}"', "\n".join([*comments, f'file = "{MEASURED}"'])))
        say(f"wrote {study}")
    say(f"next: calflow check {into}")


def _source_lines(files: Sequence[Path], origins: Sequence[ColumnOrigin]) -> list[str]:
    """Return lines on the origin of the measurements, for a comment in the study file."""
    named = ", ".join(escaped(file.name) for file in files)
    return [
        f"imported from {named}:",
        *(f"{o.ours}: {escaped(o.theirs) or '–'}, {o.how} ({escaped(o.reason)})" for o in origins),
    ]
