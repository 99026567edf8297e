"""Prediction: where a calibrated robot's markers will be, and how surely."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.estimation.calibrated import calibrated
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.plausibility import plausible
from calflow.files.problems import refuse
from calflow.measurements.columns import LABELS
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.runs.run import outdated, read_manifest, read_results


def predict(run_folder: str | Path, rows: str | Path) -> pd.DataFrame:
    """Return the rows of a CSV with where their marker will be: x_mm, y_mm, z_mm and standard deviations.

    rows has a measurement file's columns without x, y and z. The standard deviations hold what is not known of the
    parameters and the model's own discrepancy, without the measuring device's noise; where that noise was estimated from
    the fit the two cannot be told apart, and both are in. What was assumed
    of the rows stands in attrs["notes"].

    Raises:
        InputError: the run has not identified yet, or the rows are at fault.
    """
    folder, path = Path(run_folder), Path(rows)
    if not read_manifest(folder):
        raise refuse("holds no run: expected a folder that 'calflow run' has filled", folder)
    robot = Robot.from_toml(folder / "inputs" / "robot.toml")
    reason = outdated(folder, "identify", robot)
    if reason:
        raise refuse(f"holds no identified robot: {reason}; run the study again", folder)
    results = read_results(folder, "identify")
    if outdated(folder, "diagnose", robot) is None:
        results |= read_results(folder, "diagnose")
    if path.suffix.lower() == ".mat":
        raise refuse("expected a CSV", path)
    origin = results.document("identify/summary.json", IdentifySummary).time_origin_s
    data = plausible(Measurements.to_predict(path, robot, time_origin=origin), path)
    known = calibrated(robot, results, data.given)
    position = known.model.point(known.estimate, data.rows)
    jacobian = known.model.point_jacobian(known.estimate, data.rows)
    variance = np.einsum("nai,ij,naj->na", jacobian, known.covariance, jacobian)
    variance += (known.discrepancy if known.noise_known else known.sigma) ** 2
    asked = pd.read_csv(path, dtype=str, keep_default_na=False, skip_blank_lines=False, encoding="utf-8-sig").fillna("")
    asked = asked.iloc[data.table["line"] - 2].reset_index(drop=True)  # without empty lines
    for name in asked:
        asked[name] = data.table[name] if name in LABELS else pd.to_numeric(asked[name])
    for i, axis in enumerate("xyz"):
        asked[f"{axis}_mm"] = 1e3 * position[:, i]
    for i, axis in enumerate("xyz"):
        asked[f"sd_{axis}_mm"] = 1e3 * np.sqrt(variance[:, i])
    asked.attrs["notes"] = (*data.notes, *_columns_mended(results.tables["identify/faults.csv"]), *_beyond_limits(data))
    return asked


def _columns_mended(faults: pd.DataFrame) -> list[str]:
    """Say which columns of the measurements were wrong throughout: rows to predict are taken as they stand."""
    return [
        f"{said}; the rows to predict are taken to be right" for said in faults.loc[faults["row"] == 0, "statement"]
    ]


def _beyond_limits(data: Measurements) -> list[str]:
    """Name the rows at which a joint is past its limits: what is predicted there is extrapolated."""
    q = data.joints @ data.robot.reading_matrix.T
    low, high = data.robot.limits.T
    past = (q < low - 1e-9) | (q > high + 1e-9)
    lines = data.table["line"].to_numpy()
    return [
        f"joint {i + 1} is past its limits in line {', '.join(map(str, lines[past[:, i]][:5]))}"
        f"{' and more' if past[:, i].sum() > 5 else ''}: the prediction there is extrapolated"
        for i in np.flatnonzero(past.any(axis=0))
    ]
