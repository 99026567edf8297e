"""Commands that use a calibrated robot: predict, compensate, export and filter."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import calflow as cf
from calflow.commands.console import (
    FILE,
    NEW_FILE,
    NOT_WELL,
    OVER,
    ArgumentCommand,
    check_apart,
    check_unwritten,
    cli,
    deliver,
    hand_over,
    say,
    say_notes,
    write_free,
)
from calflow.files.problems import Problem, refuse_any
from calflow.files.words import plural

if TYPE_CHECKING:
    import pandas as pd

    from calflow.deployment.export import Format
    from calflow.deployment.prediction import Missing
    from calflow.programs.correction import Filtered, FilteredTarget


WITHOUT_CONDITIONS = click.option(
    "--without-conditions", is_flag=True, help="Keep rows that lack needed columns, with a wider standard deviation."
)
NOTES_PRINTED = 20  # most notes of one kind that are printed
NO_GAIN = "no gain is certain: the model itself may be off by more than these {} correct"


@cli.command("predict")
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="ROWS.csv", type=FILE)
@click.option("--out", type=NEW_FILE, help="CSV to write; printed by default.")
@OVER
@WITHOUT_CONDITIONS
def predict_command(study_or_run: Path, rows: Path, out: Path | None, force: bool, without_conditions: bool) -> None:
    """Predict where the calibrated robot's markers will be at the joints and conditions of ROWS.csv.

    Give the run's folder, or its study.
    """
    from calflow.deployment.prediction import predict_rows
    from calflow.runs.given_rows import rows_to_predict

    check_apart(out, "--out", rows)
    calibration = cf.Calibration.load(study_or_run)
    given = rows_to_predict(calibration, rows)
    predicted = predict_rows(calibration, given.data, "widen" if without_conditions else "refuse")
    say_notes((*calibration.warnings, *given.data.notes, *calibration.notes, *predicted.notes))
    deliver(given.text(given.beside(predicted.table)), out, force)


@cli.command("compensate")
@click.argument("study_or_run", type=FILE)
@click.argument("targets", metavar="TARGETS.csv", type=FILE)
@click.option("--out", type=NEW_FILE, help="CSV to write; printed by default.")
@OVER
@click.option(
    "--frames", type=FILE, help="TOML file of the frames that a column 'frame' names, besides measuring and base."
)
@click.option(
    "--in-order",
    is_flag=True,
    help="The robot goes from row to row: the side from which each joint comes follows from the commands.",
)
@WITHOUT_CONDITIONS
def compensate_command(
    study_or_run: Path, targets: Path, out: Path | None, force: bool, frames: Path | None, in_order: bool,
    without_conditions: bool,
) -> None:  # fmt: skip
    """Work out joint commands with which the real robot lands on the targets of TARGETS.csv.

    Give the run's folder, or its study. Exit code: 0 if every target is reached, 3 if some are not.
    """
    from calflow.deployment.compensation import command_table
    from calflow.runs.given_rows import compensate_file

    check_apart(out, "--out", targets)
    calibration = cf.Calibration.load(study_or_run)
    missing: Missing = "widen" if without_conditions else "refuse"
    given, compensation = compensate_file(calibration, targets, frames=frames, in_order=in_order, missing=missing)
    say_notes((*calibration.warnings, *compensation.notes))
    table = given.beside(command_table(compensation, in_order))
    landed = table[table["reached"]]
    if out is None:
        hand_over(given.text(table))
    else:
        write_free(out, given.text(table).encode(), force)
        _say_reached(landed, len(table))
    if len(landed) < len(table):
        sys.exit(NOT_WELL)


def _say_reached(landed: pd.DataFrame, targets: int) -> None:
    """Print how many targets are reached, and how far off the robot would land without and with the commands."""
    say(f"{len(landed)} of {plural(targets, 'target')} reached")
    if len(landed):
        before, now = (_rms(landed[name].tolist()) for name in ("nominal_miss_mm", "expected_mm"))
        say(f"RMS distance from the target: {before:.3f} mm with nominal commands, {now:.3f} mm expected with these")
        if now >= before:
            say(NO_GAIN.format("commands"))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


@cli.command("export", cls=ArgumentCommand)
@click.argument("study_or_run", type=FILE)
@click.option(
    "--to",
    type=click.Choice(["urdf", "xacro-properties", "dh", "json", "controller", "mjcf", "ur-calibration", "abb-moc", "kuka-dat",
                       "fanuc-mastering"]),
    required=True,
    help="urdf; xacro-properties (origins alone); dh (a robot file); json; controller (a CSV of figures to type in); "
    "mjcf (MuJoCo's); ur-calibration (what Universal Robots' ROS driver loads); abb-moc, kuka-dat, fanuc-mastering (what to paste "
    "into the controller's own files, given with --beside).",
)  # fmt: skip
@click.option("--beside", type=FILE, multiple=True, help="The controller's own file as it is today; may be repeated.")
@click.option("--out", type=NEW_FILE, help="File to write; printed by default.")
@OVER
def export_command(study_or_run: Path, to: Format, beside: tuple[Path, ...], out: Path | None, force: bool) -> None:
    """Write the calibrated robot for other programs, and say what their format cannot hold.

    Give the run's folder, or its study.
    """

    calibration = cf.Calibration.load(study_or_run)
    exported = calibration.export(to, beside)
    say_notes((*calibration.warnings, *exported.notes))
    deliver(exported.text, out, force)


@cli.command("filter")
@click.argument("study_or_run", type=FILE)
@click.argument("program", metavar="PROGRAM|FOLDER|BACKUP.zip", type=FILE)
@click.option("--out", type=FILE, help="What to write; NAME.corrected.EXT beside the program by default.")
@OVER
@click.option("--summary", type=NEW_FILE, help="CSV to write with what became of each target.")
@click.option("--payload", help='What is carried, by its name in the robot file; "": nothing.')
@click.option(
    "--tool",
    "tools",
    multiple=True,
    help="NAME=numbers of a tool that stands elsewhere, as its maker writes them; NAME alone: where the program names none.",
)
@click.option("--frame", "frames", multiple=True, help="The same of work objects, bases and user frames.")
@click.option(
    "--base", help="Where the controller's base or world is in the robot file's base, as its maker writes frames."
)
@click.option("--flange", help="Where the controller's flange is in the robot file's.")
@click.option("--start", help="Joint readings near the first target, in degrees (mm of slides): q1,q2,…")
@click.option("--any-configuration", is_flag=True, help="Correct targets even if their flags fit no way to reach them.")
@click.option("--in-order", is_flag=True, help="The robot moves in the order in which the moves stand in each file.")
@click.option("--condition", "conditions", multiple=True, help="temperature_degC=VALUE, time_s=VALUE and the like.")
@click.option("--without-conditions", is_flag=True, help="Go on without conditions that the model needs.")
@click.option("--strict", is_flag=True, help="Write nothing unless every target is corrected.")
@click.option("--although-unusable", is_flag=True, help="Go on with a model that the run says not to use.")
def filter_command(
    study_or_run: Path, program: Path, out: Path | None, force: bool, summary: Path | None, start: str | None,
    conditions: tuple[str, ...], without_conditions: bool, strict: bool, although_unusable: bool, **stated: Any,
) -> None:  # fmt: skip
    """Rewrite the targets of a robot program, or of all programs of a backup, so that the real robot lands on them.

    RAPID, KRL, FANUC LS and URScript are read, in a folder or an archive as one project: tools, frames and targets of
    other files are found there. Every byte but the targets' numbers stays. Give the run's folder, or its study. Exit
    code: 0 if every target is corrected, 3 if some are not, 2 if the program is refused.
    """
    from calflow.files.tables import csv_text, to_frame
    from calflow.files.writing import write_whole
    from calflow.programs.backup import check_folder, content_of, write_files
    from calflow.programs.correction import FilteredTarget

    target = out or program.with_name(f"{program.stem}.corrected{program.suffix}")
    check_apart(target, "--out", program)
    if program.is_dir() and (
        target.resolve().is_relative_to(program.resolve()) or program.resolve().is_relative_to(target.resolve())
    ):
        raise click.UsageError(f"--out {target}: expected a folder apart from {program}")
    check_apart(summary, "--summary", program, target)
    calibration = cf.Calibration.load(study_or_run)
    if not although_unusable:
        refuse_any(Problem(f"{message}; --although-unusable goes on with it") for message in calibration.warnings)
    done = cf.filter_program(
        calibration, program, start=_numbers("--start", start), conditions=dict(map(_condition, conditions)),
        missing="widen" if without_conditions else "refuse", **stated,
    )  # fmt: skip
    if program.is_dir():
        check_folder(done.files, target)
    else:
        check_unwritten(target, content_of(program, done.files), force)
    table = csv_text(to_frame(done.rows, FilteredTarget)).encode()
    if summary is not None:
        check_unwritten(summary, table, force, "another name")
    say(*summary_lines(program, done))
    say_notes((*calibration.warnings, *calibration.notes, *done.notes))
    lacking = len(done.uncorrected)
    written = done.is_corrected and not (strict and lacking)
    if written:
        write_files(program, done.files, target)
    if summary is not None:
        write_whole(summary, table)
        say(f"wrote {summary}")
    why = f"not corrected: {plural(lacking, 'target')}" if lacking else "no target is stated by numbers"
    say(f"wrote {target}" if written else f"wrote no program: {why}")
    if lacking or not written:
        sys.exit(NOT_WELL)


def summary_lines(program: Path, done: Filtered) -> list[str]:
    """Return lines on how far targets moved, which did not and why, changed configuration flags, and assumptions."""
    rows, outcomes = done.rows, Counter(row.outcome for row in done.rows)
    targets = [row for row in rows if row.kind and row.outcome != "follows"]
    moved = [row for row in targets if row.outcome == "moved"]
    counts = ", ".join(f"{outcomes[outcome]} {outcome}" for outcome in ("moved", "unchanged", "not reached"))
    lines = [
        f"{program}: {plural(len(targets), 'target')} stated by numbers: {counts}; {outcomes['left alone']} left alone"
    ]
    if sum(row.kind == "pose" and row.reason == "out of reach" for row in targets) > len(targets) / 2:
        lines.append(
            "most are not reached: are base and flange of the robot file the controller's? See --base and --flange"
        )
    lines += _distances(rows, moved)
    if reasons := Counter(row.reason for row in rows if row.reason):
        lines.append(f"not corrected, by reason: {', '.join(f'{reason} {n}' for reason, n in reasons.most_common())}")
    for outcome in ("not reached", "left alone"):
        lines += _first([f"{outcome}: {_of(row)}: {row.note}" for row in rows if row.outcome == outcome])
    lines += _first([f"configuration changes: {_of(row)}: {row.configuration}" for row in moved if row.configuration])
    return lines + _first([f"assumed: {_of(row)}: {row.note}" for row in moved if row.note])


def _distances(rows: Sequence[FilteredTarget], moved: Sequence[FilteredTarget]) -> Iterator[str]:
    """Yield lines on how far targets moved, and on the errors to expect where they land."""
    if moved:
        mean, most = sum(row.moved_mm for row in moved) / len(moved), max(moved, key=lambda row: row.moved_mm)
        yield (
            f"moved by {mean:.3f} mm on average, at most {most.moved_mm:.3f} mm ({_of(most)}); "
            f"no joint by more than {max(row.largest_deg for row in moved):.3f} degrees"
        )
    if promised := [row.promised_mm for row in rows if not math.isnan(row.promised_mm)]:
        yield f"expected error where they land: {_rms(promised):.3f} mm, root mean square; at most {max(promised):.3f}"
    if moved and _rms([row.promised_mm for row in moved]) >= _rms([row.moved_mm for row in moved]):
        yield NO_GAIN.format("targets")
    if following := [row for row in rows if row.outcome == "follows"]:
        worst = max(following, key=lambda row: row.remaining_mm)
        yield (
            f"computed from these and moved with them: {len(following)}; "
            f"by the model they land within {worst.remaining_mm:.3f} mm ({_of(worst)})"
        )


def _first(lines: list[str]) -> list[str]:
    """Return the first of many lines, and a line that counts the others."""
    left = len(lines) - NOTES_PRINTED
    more = [f"… and {left} more like this: --summary has them all"] if left > 0 else []
    return lines[:NOTES_PRINTED] + more


def _of(row: FilteredTarget) -> str:
    return f"{row.name} ({row.file}:{row.line})"


def _numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        return tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise click.BadParameter(f"expected numbers, found '{text}'", param_hint=option) from None


def _condition(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    numbers = _numbers("--condition", value) or ()
    if len(numbers) != 1:
        raise click.BadParameter(f"expected NAME=VALUE, found '{text}'", param_hint="--condition")
    return name.strip(), numbers[0]
