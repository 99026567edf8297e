"""What is wrong with a study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calflow.commands.options import FILE

if TYPE_CHECKING:
    from calflow.measurements.measurements import Measurements


@click.command()
@click.argument("study", type=FILE)
def check(study: Path) -> None:
    """Check a study with its robot, workflow and measurements, and run nothing."""
    from calflow.runs.checking import check as check_study
    from calflow.stages.demand import memory_there, warned
    from calflow.study import load_study

    loaded = load_study(study)
    checked = check_study(loaded)
    click.echo(f"study {loaded.name}: {loaded.robot.name}, workflow {loaded.workflow.name} "
               f"({', '.join(loaded.stages)})")  # fmt: skip
    if checked is None:
        click.echo("no measurements yet: 'calflow run --stage select' proposes poses")
        return
    data = checked.data
    for doubt in checked.doubts:
        click.echo(f"warning: {doubt.statement}")
    for note in data.notes:
        click.echo(f"note: {note}")
    for k, path in enumerate(loaded.measurement_paths):
        click.echo(_counted(path, data.only(data.of_series(k))))
    for fault in checked.faults:
        click.echo(f"fault: {fault.said}")
    source = "as the robot file says" if loaded.robot.base.known else "placed by the poses to fit"
    click.echo(f"the nominal robot's position error, base and tool {source}:")
    for row in checked.nominal.itertuples():
        click.echo(f"  {row.split:8} mean {row.mean_mm:.3f} mm, max {row.max_mm:.3f} mm")
    click.echo(f"{checked.n_parameters} parameters: {', '.join(loaded.file.effects)}")
    for name, demand in checked.demands.items():
        click.echo(f"{name} will take {demand.words}")
        if said := warned(name, demand, memory_there()):
            click.echo(said)
    click.echo("ok")


def _counted(path: Path, data: Measurements) -> str:
    fitted = data.table.loc[data.train, "pose"].nunique()
    return f"{path}: {len(data)} rows, {data.table['pose'].nunique()} poses, {fitted} of them to fit"
