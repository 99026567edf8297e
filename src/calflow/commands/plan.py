"""What would run."""

from __future__ import annotations

from pathlib import Path

import click

from calflow.commands.options import FILE, FORCE, OUT, STAGE
from calflow.commands.output import say


@click.command()
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def plan(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Show which stages would run and what they would take, which would be reused, and why."""
    from calflow.runs.folder import default_folder
    from calflow.runs.planning import foreseen
    from calflow.runs.planning import plan as make_plan
    from calflow.stages.demand import Demand
    from calflow.study import load_study

    loaded = load_study(study)
    steps = make_plan(loaded, out or default_folder(loaded), stage, force)
    demands = foreseen(loaded, [step.stage for step in steps if not step.reuse])
    for step in steps:
        demand = demands.get(step.stage.name, Demand())
        taken = f"; takes {demand.words}" if demand.words else ""
        say(f"{step.stage.name:14} {'reuse' if step.reuse else 'run':6} {step.reason}{taken}")
