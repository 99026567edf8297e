"""Commands that run a study: run, plan, status, report and doctor."""

from __future__ import annotations

import sys
from pathlib import Path

import click

import calflow as cf
from calflow.commands.console import FILE, FORCE, OUT, STAGE, cli, progress, resumable, say, show_table


@cli.command("run")
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def run_command(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Run a study: what did not change is reused, what was interrupted is resumed."""
    from calflow.reporting.terminal import last_lines

    with resumable(), progress() as listener:
        result = cf.run(cf.load_study(study), out, stage, force, listener)
    say(*last_lines(result))
    report = result.folder / "report.pdf"
    say(
        f"report: {report}"
        if report.is_file()
        else f"results: {result.folder} (calflow report {result.folder} makes a PDF)"
    )


@cli.command("plan")
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def plan_command(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Show which stages would run and what they would take, which would be reused, and why."""
    from calflow.run_folder import default_folder
    from calflow.runs.planning import foreseen, plan
    from calflow.stages.demand import Demand

    loaded = cf.load_study(study)
    steps = plan(loaded, out or default_folder(loaded), stage, force)
    demands = foreseen(loaded, [step.stage for step in steps if not step.reuse])
    for step in steps:
        demand = demands.get(step.stage.name, Demand())
        taken = f"; takes {demand.words}" if demand.words else ""
        say(f"{step.stage.name:14} {'reuse' if step.reuse else 'run':6} {step.reason}{taken}")


@cli.command("status")
@click.argument("study_or_run", type=FILE)
def status_command(study_or_run: Path) -> None:
    """Show how far a run has come: give its folder, or its study."""
    from calflow.files.problems import refuse
    from calflow.run_folder import read_manifest, run_folder
    from calflow.runs.lock import is_locked

    folder = run_folder(study_or_run)
    manifest = read_manifest(folder)
    if manifest is None:
        raise refuse("nothing has been run here yet", folder)
    say(f"{folder}: study {manifest.study}, workflow {manifest.workflow}, calflow {manifest.calflow}")
    for name, entry in manifest.stages.items():
        status = "interrupted" if entry.status == "running" and not is_locked(folder) else entry.status
        seconds = "" if entry.seconds is None else f"{entry.seconds:.1f} s"
        reused = f"; reused since: {entry.reused}" if entry.reused else ""
        say(f"{name:14} {status:12} {seconds:>8}  ran because: {entry.reason}{reused}")


@cli.command("report")
@click.argument("study_or_run", type=FILE)
@OUT
def report_command(study_or_run: Path, out: Path | None) -> None:
    """Write the report of a run's results anew: give its folder, or its study."""
    from calflow.run_folder import study_and_folder

    study, folder = study_and_folder(study_or_run, out)
    with resumable(), progress() as listener:
        result = cf.run(study, folder, "report", True, listener)
    say(f"report: {result.folder / 'report.pdf'}")


@cli.command("doctor")
def doctor_command() -> None:
    """Tell what this machine has of what calflow needs, what makes it slow, and what to do.

    Exit code: 0 if calflow can be relied on, even if it is slow, 1 if something must be fixed first.
    """
    from calflow.runs.doctor import examine

    findings = examine()
    rows = ((finding.what, finding.state, finding.found, finding.remedy) for finding in findings)
    show_table(rows, ("what", "state", "found", "what to do"))
    wrong = [finding.what for finding in findings if finding.state == "trouble"]
    slow = [finding.what for finding in findings if finding.state == "slow"]
    if slow:
        say(f"slow because of: {', '.join(slow)}")
    say(f"to be fixed first: {', '.join(wrong)}" if wrong else "calflow can be relied on")
    sys.exit(1 if wrong else 0)
