"""A run again, and what differs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE
from calflow.commands.output import say
from calflow.commands.progress import progress

if TYPE_CHECKING:
    from calflow.files.deviations import Deviation
    from calflow.runs.reproduce import Reproduction

DIFFERS, CANNOT = 1, 2
MOST_TOLD = 40  # columns that are told one by one


@click.command()
@click.argument("run", type=FILE)
@click.option("--out", type=FILE, help="Empty folder to keep the study, its run and the differences in.")
def reproduce(run: Path, out: Path | None) -> None:
    """Run RUN, a run folder or an unpacked archive, again from its own inputs, and tell bit by bit what differs.

    Ends with 0 where every file has the same bytes, 1 where one differs, and 2 where it cannot be done.
    """
    from calflow.runs.reproduce import reproduce as reproduce_run

    try:
        with progress() as listener:
            found = reproduce_run(run, out, listener)
    except OSError as error:  # which elsewhere ends with 1
        say(f"error: {error}", err=True)
        sys.exit(CANNOT)
    say(*reproduction_lines(found))
    if out is not None:
        say(f"run: {out / 'run'}, differences: {out / 'differences.csv'}")
    sys.exit(DIFFERS if found.other else 0)


def reproduction_lines(found: Reproduction) -> list[str]:
    """Say how many files are the same, what differs by how much, and which versions changed."""
    lines = [f"{name} did not finish in this run, and was not compared" for name in found.unfinished]
    if not found.other:
        there = "" if not found.changed else f", though versions changed: {'; '.join(found.changed)}"
        return [*lines, f"the same: all {len(found.same)} files have the same bytes{there}"]
    lines += [_line(one) for one in found.deviations[:MOST_TOLD]]
    if len(found.deviations) > MOST_TOLD:
        lines.append(f"… and {len(found.deviations) - MOST_TOLD} more columns: --out keeps them all")
    told = {one.file for one in found.deviations}
    if rest := [name for name in found.other if name not in told]:
        lines.append(f"other bytes in {', '.join(rest)}")
    changed = "; ".join(found.changed) or "none: machine, compiler settings or threads may"
    same, every = len(found.same), len(found.same) + len(found.other)
    return [*lines, f"versions that changed: {changed}", f"differs: {same} of {every} files have the same bytes"]


def _line(one: Deviation) -> str:
    if one.absolute is None:
        return f"{one.file}, {one.name}: {one.cells} cells, first {one.was!r} → {one.now!r}"
    size = f"at most {one.absolute:.2g}"
    parts = [
        *([] if one.relative is None else [f"relative {one.relative:.2g}"]),
        *([] if one.in_sd is None else [f"{one.in_sd:.2g} sd"]),
    ]
    more = f" ({', '.join(parts)})" if parts else ""
    return f"{one.file}, {one.name}: {one.cells} cells, {size}{more}, {one.was} → {one.now}"
