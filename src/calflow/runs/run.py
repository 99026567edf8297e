"""A run: a study's stages in order, results reused where nothing changed, interrupted work resumed."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from calflow.files.results import Documents, Results
from calflow.files.tables import Tables
from calflow.files.writing import PART, inside, write_whole
from calflow.measurements.reading import fetch
from calflow.run_folder import default_folder, read_manifest, read_results
from calflow.runs.execution import execute, record_reuse
from calflow.runs.listener import Listener, Silent
from calflow.runs.lock import locked
from calflow.runs.planning import foreseen, passed_over, plan
from calflow.stages import STAGES
from calflow.stages.demand import memory_there, warned
from calflow.study import Study


@dataclass(frozen=True)
class Run:
    """A finished run: its folder, and every table and document by its path in it."""

    folder: Path
    results: Results = field(repr=False)

    @property
    def tables(self) -> Tables:
        """Every table by its path."""
        return self.results.tables

    @property
    def documents(self) -> Documents:
        """Every document (JSON) by its path."""
        return self.results.documents


def run(
    study: Study,
    folder: str | Path | None = None,
    stage: str | None = None,
    force: bool = False,
    listener: Listener | None = None,
) -> Run:
    """Run a study's stages, reusing what did not change, and return all tables.

    Args:
        study: see `load_study`.
        folder: the run folder; `runs/<study name>` by default.
        stage: run this stage alone (and what it needs, where that is not there yet).
        force: do not reuse.
        listener: is told how it goes on.

    Raises:
        InputError: the study's input is at fault, or a file that it names by a url cannot be fetched.
    """
    folder = Path(folder) if folder is not None else default_folder(study)
    listener = listener or Silent()
    if stage is None or (stage in STAGES and STAGES[stage].measured):
        for source in study.all_to_fetch:
            listener.say(f"fetching {source.file} from {source.url}; expecting SHA-256 {source.sha256}")
            fetch(source)
    steps = plan(study, folder, stage, force)
    if any(step.stage.measured and not step.reuse for step in steps):
        study.measurements()  # what is wrong with them is told before any work is done
    settings = {step.stage.name: study.validated_settings(step.stage.name, step.stage.settings) for step in steps}
    for name, demand in foreseen(study, [step.stage for step in steps if not step.reuse]).items():
        if said := warned(name, demand, memory_there()):
            listener.say(said)
    planned = read_manifest(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        if read_manifest(folder) != planned:  # another run was at work in the meantime
            steps = plan(study, folder, stage, force)
        _keep_inputs(study, folder)
        results = Results()
        for name in passed_over(folder, stage, steps):
            listener.say(
                f"{name} is left out: its results are of other inputs, settings or versions, or were changed since; "
                "run the study to renew them"
            )
        for step in steps:
            if step.reuse:
                listener.reuse(step.stage, step.reason)
                record_reuse(study, folder, step)
            else:
                listener.start(step.stage, step.reason)
                started = time.monotonic()
                execute(study, folder, step, settings[step.stage.name], results, listener)
                listener.finish(step.stage, time.monotonic() - started)
            manifest = read_manifest(folder)
            assert manifest is not None
            results |= read_results(manifest, folder, step.stage.name)
    return Run(folder, results)


def _keep_inputs(study: Study, folder: Path) -> None:
    """Copy the files that were asked, so that the run folder alone tells what was done and can predict."""
    for part in (*folder.glob(f".*{PART}"), *inside(folder, "inputs").glob(f".*{PART}")):  # of a run that was killed
        part.unlink()
    robot, *described = study.robot_paths
    for name, path in (
        ("study.toml", study.path),
        ("robot.toml", robot),
        *((path.name, path) for path in described),  # where the robot file says that it is: beside it
        ("workflow.toml", study.workflow_path),
    ):
        write_whole(inside(folder, f"inputs/{name}"), path.read_bytes())
