"""Commands for a fleet of robots: plan, run, status and report."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.console import FILE, FOLDER, NOT_WELL, NUMBER, cli, progress, resumable, say

if TYPE_CHECKING:
    from calflow.fleet.engine import FleetFolder
    from calflow.fleet.fleet import Fleet

ALLOW = click.option(
    "--allow",
    type=FILE,
    multiple=True,
    metavar="FOLDER",
    help="A folder besides the fleet file's own in which it may name files; may be repeated.",
)
OUT = click.option("--out", type=FOLDER, help="The fleet's folder; runs/<fleet name> by default.")


@cli.group("fleet")
def fleet_command() -> None:
    """Calibrate many robots of a few types, on one machine or a cluster."""


@fleet_command.command("plan")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_plan_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Show which robots would be calibrated, and why; writes each one's study, and runs none."""
    from calflow.fleet.engine import check_engine
    from calflow.fleet.standing import planned

    check_engine()
    for line in planned(*_opened(fleet_file, out, allow)):
        say(line)


@fleet_command.command("run")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@click.argument("options", metavar="[-- SNAKEMAKE OPTIONS]", nargs=-1)
@OUT
@ALLOW
@click.option("--cores", type=click.IntRange(min=1), help="Of this machine; all by default.")
@click.option("--batch", type=click.IntRange(min=1), help="Robots that a cluster is given as one job.")
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

    Exit code: 0 if every robot is calibrated, 3 if some are not.
    """
    from calflow.fleet.engine import LOG, check_engine, command, held, running
    from calflow.fleet.fleet_report import write_summary
    from calflow.fleet.standing import arriving, fleet_lines, forget_stale, outcomes, uncalibrated_lines
    from calflow.runs.lock import locked
    from calflow.study import workflow_folder

    check_engine()
    loaded, folder = _opened(fleet_file, out, allow)
    cores = cores or os.cpu_count() or 1
    folder.path.mkdir(parents=True, exist_ok=True)
    with resumable(), locked(folder.path), held(folder.path) as lock:
        forget_stale(loaded, folder)
        config = {
            "fleet": str(loaded.path.resolve()),
            "out": str(folder.path),
            "allow": [str(path.resolve()) for path in allow],
        }
        grouped = ("--groups", "calibrate=robots", "--group-components", f"robots={batch}") if batch else ()
        called = command(workflow_folder() / "fleet.smk", config, folder.path, cores, profile, (*grouped, *options))
        with running(called, folder.path, lock) as process:
            for line in arriving(loaded, folder, lambda: process.poll() is not None):
                say(f"{line.robot}: {line.verdict or line.status}")
        reached = outcomes(loaded, folder)
        if process.returncode:
            say(f"Snakemake ended with {process.returncode}: what it said is in {folder.path / LOG}", err=True)
            write_summary(loaded, folder, reached)
    say(*fleet_lines(reached), *uncalibrated_lines(reached))
    say(f"report: {folder.path / 'report.pdf'}")
    sys.exit(0 if all(outcome.status == "calibrated" for outcome in reached) else NOT_WELL)


@fleet_command.command("status")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_status_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Show how far a fleet has come, and what failed."""
    from calflow.fleet.standing import fleet_lines, outcomes, uncalibrated_lines

    reached = outcomes(*_opened(fleet_file, out, allow))
    say(*fleet_lines(reached), *uncalibrated_lines(reached))


@fleet_command.command("report")
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@OUT
@ALLOW
def fleet_report_command(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Write fleet.csv and the reports anew from what came of the robots so far."""
    from calflow.fleet.fleet_report import write_summary
    from calflow.fleet.standing import outcomes, uncalibrated_lines

    loaded, folder = _opened(fleet_file, out, allow)
    say(*uncalibrated_lines(write_summary(loaded, folder, outcomes(loaded, folder))))
    say(f"report: {folder.path / 'report.pdf'}")


@fleet_command.command("work", hidden=True)
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@click.argument("robot")
@click.option("--out", type=FILE, required=True)
@ALLOW
@click.option("--minutes", type=NUMBER, required=True)
@click.option("--attempt", type=int, required=True)
def fleet_work_command(
    fleet_file: Path, robot: str, out: Path, allow: tuple[Path, ...], minutes: float, attempt: int
) -> None:
    """Supervise a robot's calibration as a job of the workflow; the last attempt writes an outcome even if it fails."""
    from calflow.fleet.engine import RETRIES, FleetFolder, supervise

    began, folder = time.time_ns(), FleetFolder(out)
    outcome = folder.outcome(robot)
    outcome.unlink(missing_ok=True)
    called = [sys.executable, "-m", "calflow", "fleet", "calibrate", str(fleet_file), robot, "--out", str(out)]
    why = supervise([*called, *(f"--allow={path}" for path in allow)], folder.log(robot), minutes)
    if why and attempt <= RETRIES:
        sys.exit(1)
    if why and not outcome.exists():
        from calflow.fleet.calibration import failed
        from calflow.fleet.standing import write_outcome

        loaded, folder = _opened(fleet_file, out, allow)
        write_outcome(outcome, failed(loaded.robot(robot), folder, why, began))


@fleet_command.command("calibrate", hidden=True)
@click.argument("fleet_file", metavar="FLEET.toml", type=FILE)
@click.argument("robot")
@OUT
@ALLOW
def fleet_calibrate_command(fleet_file: Path, robot: str, out: Path | None, allow: tuple[Path, ...]) -> None:
    """Calibrate a robot of a fleet, and write what came of it."""
    from calflow.fleet.calibration import calibrate

    loaded, folder = _opened(fleet_file, out, allow)
    with resumable(), progress() as listener:
        calibrate(loaded.robot(robot), folder, listener)


def _opened(fleet_file: Path, out: Path | None, allow: tuple[Path, ...]) -> tuple[Fleet, FleetFolder]:
    from calflow.fleet.fleet import load_fleet
    from calflow.fleet.standing import fleet_folder

    loaded = load_fleet(fleet_file, allow)
    return loaded, fleet_folder(loaded, out)
