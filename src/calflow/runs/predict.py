"""Prediction from a run folder: rows of a CSV with where their marker will be."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from calflow.deployment.needed_conditions import NeededCondition
from calflow.deployment.prediction import Missing, predict_positions
from calflow.estimation.calibrated import calibrated
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.plausibility import plausible
from calflow.files.problems import refuse
from calflow.files.toml import read_toml
from calflow.measurements.columns import LABELS
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.runs.folder import read_results, run_folder
from calflow.runs.manifest import read_manifest
from calflow.runs.reasons import outdated
from calflow.study import StudyFile


def predict(study_or_run: str | Path, rows: str | Path, missing: Missing = "refuse") -> pd.DataFrame:
    """Return the rows of a CSV with where their marker will be: x_mm, y_mm, z_mm and standard deviations.

    The run is named by its folder, or by its study. rows has a measurement file's columns without x, y and z, with the
    separator and decimal sign of the study's measurements. The standard deviations are those of `predict_positions`, as is
    what missing says of conditions that the rows lack. What was assumed of the rows stands in attrs["notes"].

    Raises:
        InputError: the run has not identified yet, or the rows are at fault.
    """
    folder, path = run_folder(Path(study_or_run)), Path(rows)
    manifest = read_manifest(folder)
    if manifest is None:
        raise refuse("holds no run: expected a folder that 'calflow run' has filled", folder)
    robot = Robot.from_toml(folder / "inputs" / "robot.toml")
    reason = outdated(manifest, folder, "identify", robot)
    if reason:
        raise refuse(f"holds no identified robot: {reason}; run the study again", folder)
    results = read_results(manifest, folder, "identify")
    if outdated(manifest, folder, "diagnose", robot) is None:
        results |= read_results(manifest, folder, "diagnose")
    if path.suffix.lower() == ".mat":
        raise refuse("expected a CSV", path)
    separator, decimal = _written_as(folder)
    origin = results.document("identify/summary.json", IdentifySummary).time_origin_s
    data = plausible(
        Measurements.to_predict(path, robot, time_origin=origin, separator=separator, decimal=decimal), path
    )
    needed = results.rows(
        f"{'diagnose' if 'diagnose/effects.csv' in results else 'identify'}/needed_conditions.csv", NeededCondition
    )
    predicted = predict_positions(calibrated(robot, results, data.given), needed, data, missing)
    asked = pd.read_csv(
        path, sep=separator, dtype=str, keep_default_na=False, skip_blank_lines=False, encoding="utf-8-sig"
    ).fillna("")
    asked = asked.iloc[data.table["line"] - 2].reset_index(drop=True)  # without empty lines
    for name in asked:
        asked[name] = data.table[name] if name in LABELS else pd.to_numeric(asked[name].str.replace(decimal, "."))
    for i, axis in enumerate("xyz"):
        asked[f"{axis}_mm"] = 1e3 * predicted.position[:, i]
    for i, axis in enumerate("xyz"):
        asked[f"sd_{axis}_mm"] = 1e3 * predicted.sd[:, i]
    asked.attrs["notes"] = (*data.notes, *_columns_mended(results.tables["identify/faults.csv"]), *predicted.notes)
    return asked


def _written_as(folder: Path) -> tuple[str, str]:
    """Return the separator and the decimal sign of the study's own measurements, of its first series."""
    sources = read_toml(folder / "inputs" / "study.toml", StudyFile).sources
    return (sources[0].separator, sources[0].decimal) if sources else (",", ".")


def _columns_mended(faults: pd.DataFrame) -> list[str]:
    """Say which columns of the measurements were wrong throughout: rows to predict are taken as they stand."""
    whole = faults[(faults["row"] == 0) & (faults["action"] == "corrected")]
    return [f"{said}; the rows to predict are taken to be right" for said in whole["statement"]]
