"""Export from a run folder: its calibrated robot in a format that other programs read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.deployment.export import Export, Format, export
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.robot.formats.robot_file import drives
from calflow.run_folder import robot_digest, study_and_folder
from calflow.runs.calibrated_run import CalibratedRun

POSES = 500  # within the joint limits, where the measurements are not to be had
INSTEAD = "costs are over random poses within the joint limits instead"


def export_run(study_or_run: str | Path, to: Format) -> Export:
    """Return a run's calibrated robot in a format; its notes say what the format cannot hold, and what that costs in mm.

    The run is named by its folder, or by its study. The costs are told over the measured rows; where these are not to be had,
    over random poses within the joint limits.

    Raises:
        InputError: the run has not identified yet, or its robot cannot be stated in the format.
    """
    run = CalibratedRun.of(study_or_run)
    data, said = _measured(run)
    known, rows = _anywhere(run) if data is None else (run.known(data.given), data.rows)
    found = export(known, rows, to, run.robot, drives(run.folder / "inputs" / "robot.toml"))
    return replace(found, notes=(*run.warning, *said, *found.notes))


def _measured(run: CalibratedRun) -> tuple[Measurements | None, tuple[str, ...]]:
    """The measurements of a run's study; None, and why, where they are not to be had as they were fitted."""
    try:
        study, _ = study_and_folder(run.folder, None)
        data = study.measurements()
    except InputError:
        return None, (f"the measurements are not there any more: {INSTEAD}",)
    if robot_digest(study.robot) != robot_digest(
        run.robot
    ):  # payloads and markers are counted in the robot file's order
        return None, (f"the study's robot file has changed since: {INSTEAD}",)
    return data, ()


def _anywhere(run: CalibratedRun) -> tuple[CalibratedModel, np.ndarray]:
    """The calibrated model, and packed rows (n_conditions, n) at random poses under the heaviest payload."""
    known = run.known(())
    payloads = run.robot.payloads
    heaviest = max(payloads, key=lambda name: payloads[name].mass or 0.0, default="")
    _, rows = candidates(known.model, POSES, heaviest, next(iter(run.robot.markers)), None, np.random.default_rng(1))
    return known, rows
