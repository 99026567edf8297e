"""The calibration of one robot of a fleet, run as one job of the workflow engine, and its outcome."""

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
    """Write a robot's study, run it, and write its outcome, also if its files are at fault.

    Raises:
        InputError: its files are at fault.
    """
    study, run_folder, began = folder.study(robot.name), folder.run(robot.name), time.time_ns()
    try:
        write_robot_study(robot, study)
        wait_until_free(run_folder)  # the process of a killed job may still be running there
        made = run(load_study(study), run_folder, listener=listener)
    except InputError as error:
        write_outcome(folder.outcome(robot.name), failed(robot, folder, failure_reason(error, robot.home), began))
        raise
    write_outcome(folder.outcome(robot.name), calibrated_outcome(robot.name, robot.type.name, made))


def failed(robot: FleetRobot, folder: FleetFolder, why: str, began: int) -> Outcome:
    """Return the outcome of a robot that failed, with the first stage left unfinished since a time [ns]."""
    manifest = folder.run(robot.name) / NAME
    written = read_manifest(manifest.parent) if manifest.is_file() and manifest.stat().st_mtime_ns >= began else None
    stages = [name for name, entry in written.stages.items() if entry.status != "done"] if written else []
    stage = stages[0] if stages else ""
    return Outcome(robot=robot.name, type=robot.type.name, status="failed", failed_stage=stage, reason=why)


def input_state(robot: FleetRobot) -> str:
    """Return a digest of the names, sizes and dates of the existing files that a robot's study reads."""
    files = {path for path in (*robot.type.files, *robot.data) if path.is_file()}
    stats = sorted((str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files)
    return hashlib.sha256(repr(stats).encode()).hexdigest()


def made_by() -> str:
    """Return a description of the program on which outcomes depend: code digest and versions."""
    return " ".join((code_digest(), *(f"{name}={version}" for name, version in versions().items())))
