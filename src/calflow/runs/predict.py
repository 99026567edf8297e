"""Prediction from a run folder: rows of a CSV with where their marker will be."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from calflow.deployment.prediction import Missing, predict_positions
from calflow.estimation.plausibility import plausible
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.given_rows import given_rows


def predict(study_or_run: str | Path, rows: str | Path, missing: Missing = "refuse") -> pd.DataFrame:
    """Return the rows of a CSV with where their marker will be: x_mm, y_mm, z_mm and standard deviations.

    The run is named by its folder, or by its study. rows has a measurement file's columns without x, y and z, with the
    separator and decimal sign of the study's measurements. The standard deviations are those of `predict_positions`, as is
    what missing says of conditions that the rows lack. Where the run has a residual field, columns not_physical_x_mm … say what
    of the position is its. What was assumed of the rows stands in attrs["notes"].

    Raises:
        InputError: the run has not identified yet, or the rows are at fault.
    """
    run, path = CalibratedRun.of(study_or_run), Path(rows)
    if path.suffix.lower() == ".mat":
        raise refuse("expected a CSV", path)
    separator, decimal = run.source.separator, run.source.decimal
    data = plausible(
        Measurements.to_predict(path, run.robot, time_origin=run.time_origin, separator=separator, decimal=decimal),
        path,
    )
    predicted = predict_positions(run.known(data.given), run.needed, data, missing)
    asked = given_rows(path, data, run.source)
    for i, axis in enumerate("xyz"):
        asked[f"{axis}_mm"] = 1e3 * predicted.position[:, i]
    for i, axis in enumerate("xyz"):
        asked[f"sd_{axis}_mm"] = 1e3 * predicted.sd[:, i]
    if predicted.not_physical is not None:
        for i, axis in enumerate("xyz"):
            asked[f"not_physical_{axis}_mm"] = 1e3 * predicted.not_physical[:, i]
    asked.attrs["notes"] = (*run.warning, *data.notes, *run.notes, *predicted.notes)
    return asked
