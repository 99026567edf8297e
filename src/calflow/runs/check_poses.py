"""Check poses of a run: a few of the poses that were measured, and what they would show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from calflow.deployment.drift import FEWEST, Drift, check_poses, drift, unmoved
from calflow.deployment.movements import FALSE_ALARM
from calflow.files.problems import refuse
from calflow.robot.readings import reading_columns, shown_readings
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.new_measurements import read_new

LABELS = ("pose", "payload", "marker")


@dataclass(frozen=True)
class ChosenPoses:
    """Poses to check a robot by, as a table for `calflow drift`, and what that would say where nothing moved, without noise."""

    table: pd.DataFrame
    foreseen: Drift


def choose_check_poses(study_or_run: str | Path, rows: str | Path, number: int = 8) -> ChosenPoses:
    """Choose poses to check a run's robot by, of those in a file of measurements: the ones that tell best what has moved.

    Args:
        study_or_run: the run's folder, or its study.
        rows: measurements, those of the calibration or others, which say what can be reached and seen.
        number: how many to choose.

    Raises:
        InputError: the run has not identified yet, the rows are at fault, or there are fewer poses.
    """
    run = CalibratedRun.of(study_or_run)
    data = read_new(run, rows)
    known = run.known(data.given)
    there = data.table["pose"].nunique()
    if not FEWEST <= number <= there:
        raise refuse(f"expected {FEWEST} to {there}, the poses in {Path(rows).name}, found {number}", key="number")
    chosen = check_poses(known, data, number)
    names = reading_columns(run.robot)
    readings = shown_readings(run.robot, chosen.joints)
    table = chosen.table[[*LABELS]].assign(**dict(zip(names, readings.T.round(4), strict=True)))
    return ChosenPoses(
        table, drift(known, run.needed, unmoved(known, chosen), false_alarm=FALSE_ALARM, station="known")
    )
