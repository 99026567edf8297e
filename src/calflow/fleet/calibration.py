"""The calibration of a robot of a fleet, as one process of the engine does it, and what becomes of it."""

from __future__ import annotations

import hashlib
import time
from typing import Any

from calflow.deployment.usability import accuracy_steps, findings_of, is_useless, judgement, split_judged
from calflow.files.problems import InputError
from calflow.files.tables import Results
from calflow.files.units import METRE
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import FleetRobot, write_robot_study
from calflow.fleet.standing import Outcome, failure_reason, write_outcome
from calflow.run_folder import NAME, code_digest, read_manifest, versions
from calflow.runs.lock import wait_until_free
from calflow.runs.run import Listener, Silent, run
from calflow.study import load_study

SILENT = Silent()


def calibrate(robot: FleetRobot, folder: FleetFolder, listener: Listener = SILENT) -> None:
    """Write a robot's study, run it, and write what came of it; where its files are at fault, that it failed.

    Raises:
        InputError: its files are at fault.
    """
    study, run_folder, began = folder.study(robot.name), folder.run(robot.name), time.time_ns()
    try:
        write_robot_study(robot, study)
        wait_until_free(run_folder)  # the process of a job that was killed may still be at work there
        results = run(load_study(study), run_folder, listener=listener).results
    except InputError as error:
        write_outcome(folder.outcome(robot.name), failed(robot, folder, failure_reason(error), began))
        raise
    write_outcome(folder.outcome(robot.name), calibrated_outcome(robot.name, robot.type.name, results))


def failed(robot: FleetRobot, folder: FleetFolder, why: str, began: int) -> Outcome:
    """Return the outcome of a robot that failed, with the stage that did since a time [ns]."""
    manifest = folder.run(robot.name) / NAME
    written = read_manifest(manifest.parent) if manifest.is_file() and manifest.stat().st_mtime_ns >= began else None
    stages = [name for name, entry in written.stages.items() if entry.status != "done"] if written else []
    stage = stages[0] if stages else ""
    return Outcome(robot=robot.name, type=robot.type.name, status="failed", failed_stage=stage, reason=why)


def calibrated_outcome(robot: str, type_: str, results: Results) -> Outcome:
    """Return the outcome of a run from its results, which have those of identify."""
    split, every = split_judged(results), accuracy_steps(results)
    steps = [row for row in every if (row.split, row.unit) == (split, every[0].unit)]
    first, last = steps[0], steps[-1]
    lengths: dict[str, Any] = {
        "before_mean_mm": first.mean_mm, "before_max_mm": first.max_mm, "after_mean_mm": last.mean_mm, "after_max_mm": last.max_mm,
    } if first.unit == METRE.label else {}  # fmt: skip
    return Outcome(
        robot=robot, type=type_, status="calibrated", usable=not is_useless(results), verdict=judgement(results),
        judged_by=split, points=last.n,
        unit=first.unit, before_mean=first.mean, before_max=first.max, after_mean=last.mean, after_max=last.max, **lengths,
        causes=tuple(finding.in_short for finding in findings_of(results)),
    )  # fmt: skip


def input_state(robot: FleetRobot) -> str:
    """Return the state of the files that a robot's study reads, as far as they are there, in a word."""
    files = {path for path in (*robot.type.files, *robot.data) if path.is_file()}
    stats = sorted((str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files)
    return hashlib.sha256(repr(stats).encode()).hexdigest()


def made_by() -> str:
    """Return what outcomes depend on besides the files: the program."""
    return " ".join((code_digest(), *(f"{name}={version}" for name, version in versions().items())))
