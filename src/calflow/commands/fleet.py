"""All robots of a plant: what would be done, doing it, how far it is, and what came of it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.console import FILE, NOT_WELL, resumable, say

if TYPE_CHECKING:
    from calflow.fleet.fleet import Fleet
    from calflow.fleet.fleet_folder import FleetFolder
    from calflow.fleet.outcome import Outcome

ALLOW = click.option(
    "--allow",
    type=FILE,
    multiple=True,
    metavar="FOLDER",
    help="A folder besides the fleet file's own in which it may name files; may be repeated.",
)
OUT = click.option("--out", type=FILE, help="The fleet's folder; runs/<fleet name> by default.")


@click.group("fleet")
def fleet_command() -> None:
    """Calibrate many robots of a few types, on one machine or a cluster."""


@fleet_command.command("plan")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_plan_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Show which robots would be calibrated, and why; writes each one's study, and runs none."""
    from calflow.fleet.engine import check_engine
    from calflow.fleet.planned import planned

    check_engine()
    for one in planned(*_opened(fleet_file, out, allow)):
        say(one)


@fleet_command.command("run")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@click.argument("options", metavar="[-- SNAKEMAKE OPTIONS]", nargs=-1)
@OUT
@ALLOW
@click.option("--cores", type=click.IntRange(min=1), help="Of this machine; all by default.")
@click.option("--batch", type=click.IntRange(min=1), help="Robots that a job calibrates one after the other.")
@click.option("--profile", default="", help="A profile of Snakemake's, which says where jobs run: a cluster, a cloud.")
def fleet_run_command(
    fleet_file: Path,
    options: tuple[str, ...],
    out: Path | None,
    allow: tuple[Path, ...],
    cores: int | None,
    batch: int | None,
    profile: str,
) -> None:
    """Calibrate all robots: what did not change is reused, what failed is tried again, what was interrupted is resumed.

    Ends with 0 where every robot is calibrated, with 3 where some are not.
    """
    from calflow.fleet.engine import LOG, Where, check_engine, command, running
    from calflow.fleet.fleet_lines import fleet_lines, why
    from calflow.fleet.jobs import size_for
    from calflow.fleet.standing import arriving, forget_stale, outcomes
    from calflow.fleet.summary import write_summary
    from calflow.runs.lock import locked
    from calflow.study import workflow_folder

    check_engine()
    loaded, folder = _opened(fleet_file, out, allow)
    cores = cores or os.cpu_count() or 1
    folder.path.mkdir(parents=True, exist_ok=True)
    with resumable(), locked(folder.path):
        forget_stale(loaded, folder)
        size = batch or size_for(len(loaded.robots), cores)
        told = {
            "fleet": str(loaded.path.resolve()), "out": str(folder.path), "batch": size,
            "allow": [str(one.resolve()) for one in allow],
        }  # fmt: skip
        called = command(workflow_folder() / "fleet.smk", told, folder.path, Where(cores, profile, options))
        with running(called, folder.path) as process:
            for one in arriving(loaded, folder, lambda: process.poll() is not None):
                say(f"{one.robot}: {one.verdict or why(one)}")
        found = outcomes(loaded, folder)
        if process.returncode:
            say(f"Snakemake ended with {process.returncode}: what it said is in {folder.path / LOG}", err=True)
            write_summary(loaded, folder, found)
    say(*fleet_lines(found))
    _tell_failed(found)
    say(f"report: {folder.path / 'report.pdf'}")
    sys.exit(0 if all(one.status == "calibrated" for one in found) else NOT_WELL)


@fleet_command.command("status")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_status_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Show how far a fleet has come, and what failed."""
    from calflow.fleet.fleet_lines import fleet_lines
    from calflow.fleet.standing import outcomes

    found = outcomes(*_opened(fleet_file, out, allow))
    say(*fleet_lines(found))
    _tell_failed(found)


@fleet_command.command("report")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_report_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Write fleet.csv and the reports anew from what came of the robots so far."""
    from calflow.fleet.standing import outcomes
    from calflow.fleet.summary import write_summary

    loaded, folder = _opened(fleet_file, out, allow)
    _tell_failed(write_summary(loaded, folder, outcomes(loaded, folder)))
    say(f"report: {folder.path / 'report.pdf'}")


@fleet_command.command("work", hidden=True)
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@click.argument("robots", metavar="ROBOT…", nargs=-1, required=True)
@OUT
@ALLOW
def fleet_work_command(fleet_file: Path, robots: tuple[str, ...], out: Path | None, allow: tuple[Path, ...]) -> None:
    """Calibrate some robots of a fleet: a job of the workflow."""
    from calflow.fleet.work import work

    work(*_opened(fleet_file, out, allow), robots)


def _opened(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> tuple[Fleet, FleetFolder]:
    from calflow.fleet.fleet import load_fleet
    from calflow.fleet.standing import fleet_folder

    loaded = load_fleet(fleet_file, allow)
    return loaded, fleet_folder(loaded, out)


def _tell_failed(found: list[Outcome]) -> None:
    from calflow.fleet.fleet_lines import why

    for one in found:
        if one.status != "calibrated":
            say(f"! {one.robot} ({one.type}): {why(one)}")
