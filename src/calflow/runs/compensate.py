"""Compensation from a run folder: targets of a CSV with the joint readings that land on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.deployment.compensation import command_table, compensated
from calflow.deployment.inverse_kinematics import Targets, in_measuring_frame, read_frames
from calflow.deployment.prediction import Missing, beyond_limits, standing
from calflow.estimation.plausibility import plausible
from calflow.files.problems import InputError, Problem
from calflow.measurements.columns import FRAME, numbered
from calflow.measurements.measurements import Measurements
from calflow.robot.readings import reading_columns
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.given_rows import given_rows


def compensate(
    study_or_run: str | Path, targets: str | Path, *, frames: str | Path | None = None, in_order: bool = False,
    missing: Missing = "refuse", seed: int = 1,
) -> pd.DataFrame:  # fmt: skip
    """Return the targets of a CSV with the joint readings that land on them, and what is promised of each (see `Command`).

    The run is named by its folder, or by its study. targets has x, y and z, orientations where they count, joint readings
    where the nominal robot's are known, and a measurement file's payload, marker and conditions, with the separator and decimal
    sign of the study's measurements. Notes stand in attrs["notes"].

    Args:
        study_or_run: a run folder, or a study that was run.
        targets: the CSV.
        frames: a TOML file of frames that its column `frame` names, besides measuring and base.
        in_order: the robot goes from row to row, so that each joint's side of approach follows from the commands.
        missing: whether rows that lack a needed condition are refused, or done without it.
        seed: of the poses from which nominal readings are looked for.

    Raises:
        InputError: the run has not identified yet, or targets or frames are at fault.
    """
    run, path = CalibratedRun.of(study_or_run), Path(targets)
    stated = {} if frames is None else read_frames(Path(frames))
    how = {"separator": run.source.separator, "decimal": run.source.decimal}
    data = Measurements.to_reach(path, run.robot, run.time_origin, **how)
    started = not np.isnan(data.joints).any()
    if not started:
        check_external(data, path)
    elif FRAME not in data.table:
        data = plausible(data, path)
    known = run.known(data.given)
    names = data.table[FRAME].astype(str) if FRAME in data.table else [""] * len(data)
    asked = in_measuring_frame(Targets(data.position, data.rotation), list(names), stated, known, data.rows)
    found = compensated(
        known,
        run.needed,
        data,
        asked,
        start=data.joints if started else None,
        in_order=in_order,
        missing=missing,
        seed=seed,
    )
    own = given_rows(path, data, run.source)
    own = own.drop(columns=[name for name in own if str(name).split("_")[0] in numbered("q", run.robot.n_joints)])
    table = pd.concat([own, command_table(found, in_order)], axis=1)
    table.attrs["notes"] = (*run.warning, *_start_notes(data, started), *standing(known), *run.notes, *found.notes)
    return table


def check_external(data: Measurements, path: Path) -> None:
    """Check that it is said where the external axes are: no correction moves them.

    Raises:
        InputError: of some target it is not.
    """
    problems = [
        Problem(f"expected {reading_columns(data.robot)[data.robot.driven.index(i)]} of every target: joint {i + 1} is an external "
                "axis, which stays where it is commanded", path)
        for i in data.robot.external if np.isnan(data.joints[:, i]).any()
    ]  # fmt: skip
    if problems:
        raise InputError(problems)


def _start_notes(data: Measurements, started: bool) -> list[str]:
    """Say what was assumed of the rows, and of the readings that the nominal robot would be sent to."""
    if started:
        return [
            *data.notes,
            *beyond_limits(data, "the way to the target begins at the limit, and may not get there from it"),
        ]
    asked = "of the arm's joints" if data.robot.external else "q1 …"
    return [
        *data.notes,
        f"no columns {asked}: of the nominal robot's poses at each target the one furthest from its joint limits is taken; to keep "
        "a configuration, give the readings that the nominal robot would be sent to",
    ]
