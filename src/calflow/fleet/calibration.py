"""The calibration of a robot of a fleet, as one process of the engine does it, and what becomes of it."""

from __future__ import annotations

import hashlib
import time

from calflow.files.problems import InputError
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import FleetRobot, write_robot_study
from calflow.fleet.standing import Outcome, calibrated_outcome, failure_reason, write_outcome
from calflow.run_folder import NAME, code_digest, read_manifest, versions
from calflow.runs.lock import wait_until_free
from calflow.runs.run import SILENT, Listener, run
from calflow.study import load_study


def calibrate(robot: FleetRobot, folder: FleetFolder, listener: Listener = SILENT) -> None:
    """Write a robot's study, run it, and write what came of it; where its files are at fault, that it failed.

    Raises:
        InputError: its files are at fault.
    """
    study, run_folder, began = folder.study(robot.name), folder.run(robot.name), time.time_ns()
    try:
        write_robot_study(robot, study)
        wait_until_free(run_folder)  # the process of a job that was killed may still be at work there
        made = run(load_study(study), run_folder, listener=listener)
    except InputError as error:
        write_outcome(folder.outcome(robot.name), failed(robot, folder, failure_reason(error, robot.home), began))
        raise
    write_outcome(folder.outcome(robot.name), calibrated_outcome(robot.name, robot.type.name, made))


def failed(robot: FleetRobot, folder: FleetFolder, why: str, began: int) -> Outcome:
    """Return the outcome of a robot that failed, with the stage that did since a time [ns]."""
    manifest = folder.run(robot.name) / NAME
    written = read_manifest(manifest.parent) if manifest.is_file() and manifest.stat().st_mtime_ns >= began else None
    stages = [name for name, entry in written.stages.items() if entry.status != "done"] if written else []
    stage = stages[0] if stages else ""
    return Outcome(robot=robot.name, type=robot.type.name, status="failed", failed_stage=stage, reason=why)


def input_state(robot: FleetRobot) -> str:
    """Return the state of the files that a robot's study reads, as far as they are there, in a word."""
    files = {path for path in (*robot.type.files, *robot.data) if path.is_file()}
    stats = sorted((str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files)
    return hashlib.sha256(repr(stats).encode()).hexdigest()


def made_by() -> str:
    """Return what outcomes depend on besides the files: the program."""
    return " ".join((code_digest(), *(f"{name}={version}" for name, version in versions().items())))
