"""What is wrong with a study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE
from calflow.commands.output import say

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements


@click.command()
@click.argument("study", type=FILE)
def check(study: Path) -> None:
    """Check a study with its robot, workflow and measurements, and run nothing."""
    from calflow.runs.checking import check as check_study
    from calflow.study import load_study

    loaded = load_study(study)
    checked = check_study(loaded)
    say(f"study {loaded.name}: {loaded.robot.name}, workflow {loaded.workflow.name} ({', '.join(loaded.stages)})")
    for far in loaded.to_fetch:
        say(f"{far.file} is not fetched yet: 'calflow run' fetches it from {far.url}")
    if checked is None and loaded.to_fetch:
        return
    if checked is None:
        say("no measurements yet: 'calflow run --stage select' proposes poses")
        return
    data = checked.data
    for doubt in checked.doubts:
        say(f"warning: {doubt.statement}")
    for note in data.notes:
        say(f"note: {note}")
    for k, path in enumerate(loaded.measurement_paths):
        say(_counted(path, data.only(data.of_series(k))))
    for fault in checked.faults:
        say(f"fault: {fault.said}")
    source = "as the robot file says" if loaded.robot.base.known else "placed by the poses to fit"
    say(f"the nominal robot's position error, base and tool {source}:")
    for row in checked.nominal.itertuples():
        say(f"  {row.split:8} mean {row.mean_mm:.3f} mm, max {row.max_mm:.3f} mm")
    say(f"{checked.n_parameters} parameters: {', '.join(loaded.file.effects)}")
    for name, demand in checked.demands.items():
        if demand.words:
            say(f"{name} will take {demand.words}")
    for warning in checked.warnings:
        say(warning)
    say("ok")


def _counted(path: Path, data: Measurements) -> str:
    fitted = data.table.loc[data.train, "pose"].nunique()
    return f"{path}: {len(data)} rows, {data.table['pose'].nunique()} poses, {fitted} of them to fit"
