"""Commands on finished runs: pack, reproduce, compare and history."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

import calflow as cf
from calflow.commands.console import (
    FALSE_ALARM,
    FILE,
    FOLDER,
    NEW_FILE,
    NOT_WELL,
    OVER,
    ArgumentCommand,
    cli,
    exit_code,
    progress,
    say,
    say_notes,
    write_free,
)

if TYPE_CHECKING:
    from calflow.files.deviations import Deviation
    from calflow.runs.reproduce import Reproduction

COLUMNS_TOLD = 12  # most columns that are reported individually


@cli.command("pack")
@click.argument("run", type=FILE)
@click.option("--out", type=NEW_FILE, help="Archive to write; RUN.zip beside the run folder by default.")
@click.option("--licence", default="", metavar="SPDX", help="Under which terms the files may be used, e.g. CC-BY-4.0.")
@click.option("--author", multiple=True, metavar="NAME", help="Who made the measurements or the run; may be repeated.")
@OVER
def pack_command(run: Path, out: Path | None, licence: str, author: tuple[str, ...], force: bool) -> None:
    """Pack RUN, a run folder, with its inputs and versions into a zip that `calflow reproduce` repeats elsewhere, once unpacked.

    The archive is an RO-Crate.
    """
    from calflow.runs.pack import Terms

    terms = Terms(licence, author)
    write_free(out or Path(f"{run.resolve()}.zip"), cf.pack(run, terms), force)
    if not licence:
        say(
            "no licence stated, so nobody can know who may use the files: state one with --licence, e.g. CC-BY-4.0",
            err=True,
        )


@cli.command("reproduce")
@click.argument("run", type=FILE)
@click.option("--out", type=FOLDER, help="Empty folder to keep the study, its run and the differences in.")
def reproduce_command(run: Path, out: Path | None) -> None:
    """Run RUN, a run folder or an unpacked archive, again from its own inputs, and tell bit by bit what differs.

    The last line is the verdict: the same bytes, the same to so many digits, or not the same. Exit code: 0 if every
    file has the same bytes, 3 if one differs, 2 if it cannot be done.
    """
    with progress() as listener:
        reproduction = cf.reproduce(run, out, listener)
    say(*reproduction_lines(reproduction))
    if out is not None:
        say(f"run: {out / 'run'}, differences: {out / 'differences.csv'}")
    sys.exit(NOT_WELL if reproduction.other else 0)


def reproduction_lines(reproduction: Reproduction) -> list[str]:
    """Return lines on the deviations, the largest first, the changed versions, and at the end the verdict."""
    lines = [f"{name} did not finish in this run, and was not compared" for name in reproduction.unfinished]
    if not reproduction.other:
        there = "" if not reproduction.changed else f", though versions changed: {'; '.join(reproduction.changed)}"
        return [*lines, f"the same: all {len(reproduction.same)} files have the same bytes{there}"]
    most = sorted(
        reproduction.deviations,
        key=lambda deviation: -math.inf if deviation.of_largest is None else -deviation.of_largest,
    )
    lines += [_line(deviation) for deviation in most[:COLUMNS_TOLD]]
    if len(most) > COLUMNS_TOLD:
        lines.append(
            f"… and {len(most) - COLUMNS_TOLD} more columns, which differ by less or as much: --out keeps them all"
        )
    if reproduction.lacking:
        lines.append(f"only in one of the two runs: {', '.join(reproduction.lacking)}")
    named = {*reproduction.lacking, *(deviation.file for deviation in reproduction.deviations)}
    if rest := [name for name in reproduction.other if name not in named]:
        lines.append(f"drawn or packed differently, which is not measured: {', '.join(rest)}")
    changed = "; ".join(reproduction.changed) or "none: machine, compiler settings or threads may"
    return [*lines, f"versions that changed: {changed}", _verdict(reproduction)]


def _verdict(reproduction: Reproduction) -> str:
    counted = (
        f"{len(reproduction.same)} of {len(reproduction.same) + len(reproduction.other)} files have the same bytes"
    )
    if reproduction.digits is not None:
        sd = max(
            (deviation.in_sd for deviation in reproduction.deviations if deviation.in_sd is not None), default=None
        )
        beside = "" if sd is None else f", and no estimate by more than {sd:.2g} of its standard deviation"
        return f"the same to {reproduction.digits} digits: no number differs by more than rounding{beside}; {counted}"
    if reproduction.deviations or reproduction.lacking:
        return f"not the same: more than rounding differs; {counted}"
    return f"the same in all tables and summaries; {counted}"


def _line(deviation: Deviation) -> str:
    where = f"{deviation.file}, {deviation.name}: {deviation.cells} {'cell' if deviation.cells == 1 else 'cells'}"
    most = f"{f'{deviation.row}: ' if deviation.row else ''}{deviation.was or 'empty'} → {deviation.now or 'empty'}"
    if deviation.absolute is None:
        return f"{where}, first {most}"
    in_words = " " in deviation.unit
    unit = "" if deviation.unit in ("", "1") or in_words else f" {deviation.unit}"
    parts = []
    if deviation.of_largest is not None:
        parts.append(f"{deviation.of_largest:.2g} of the largest {'of that unit ' if unit else ''}there")
    if deviation.in_sd is not None:
        parts.append(f"at most {deviation.in_sd:.2g} standard deviations")
    more = f" ({', '.join(parts)})" if parts else ""
    return f"{where}, {'most in ' if deviation.row else ''}{most}{unit}, {deviation.absolute:.2g} apart{more}"


@cli.command("compare")
@click.argument("runs", metavar="RUN RUN…", type=FILE, nargs=-1, required=True)
@click.option("--out", type=FOLDER, help="Folder for tables and report; nothing is kept by default.")
def compare_command(runs: tuple[Path, ...], out: Path | None) -> None:
    """Compare runs: settings, data, parameters with the significance of their difference, accuracy and causes."""
    from calflow.reporting.comparison_report import comparison_lines, comparison_report
    from calflow.runs.between_runs import run_names
    from calflow.runs.kept import keep

    loaded = [cf.Calibration.load(run) for run in runs]
    comparison = cf.compare_runs(*loaded)
    say(*comparison_lines(comparison))
    say_notes(comparison.notes)
    if out is not None:
        keep(out, comparison, "Comparison of runs", lambda: comparison_report(run_names(loaded), comparison))
        say(f"report: {out / 'report.pdf'}")


@cli.command("history", cls=ArgumentCommand)
@click.argument("runs", metavar="RUN RUN…", type=FILE, nargs=-1, required=True)
@FALSE_ALARM
@click.option("--out", type=FOLDER, help="Folder for tables and report; nothing is kept by default.")
def history_command(runs: tuple[Path, ...], false_alarm: float, out: Path | None) -> None:
    """Tell which parameters of one robot moved between its calibrations, when, by how much, and what to recalibrate.

    Give runs of independent measurements in order of time. Exit code: 0 if nothing has moved, 3 if something has, 4 if
    something has but the runs do not tell what.
    """
    from calflow.reporting.history_report import history_lines, history_report
    from calflow.runs.kept import keep

    loaded = [cf.Calibration.load(run) for run in runs]
    result = cf.history_of_runs(*loaded, false_alarm=false_alarm)
    say(*history_lines(result))
    say_notes(result.notes)
    if out is not None:
        title = loaded[-1].request.title or loaded[-1].robot.name
        keep(out, result, title, lambda: history_report(result, title))
        say(f"report: {out / 'report.pdf'}")
    sys.exit(exit_code(result.status))
