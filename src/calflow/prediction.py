"""Prediction: where a calibrated robot's markers will be, and how surely."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.measurements import read_measurements
from calflow.problems import refuse
from calflow.robot.description import read_robot
from calflow.runs import read_tables
from calflow.stages.identified import identified


def predict(run_folder: str | Path, rows: str | Path) -> pd.DataFrame:
    """Return the rows of a CSV with where their marker will be: x_mm, y_mm, z_mm and standard deviations.

    rows has a measurement file's columns without x, y and z. The standard deviations are those of the model's parameters
    (widened where the model leaves more than the noise); the measuring device's noise is not in them.

    Raises:
        InputError: the run has not identified yet, or the rows are at fault.
    """
    folder, path = Path(run_folder), Path(rows)
    tables = read_tables(folder, "identify")
    if not tables:
        raise refuse("holds no identified robot: expected a folder that 'calflow run' has filled", folder)
    robot = read_robot(folder / "inputs" / "robot.toml")
    data = read_measurements(path, robot, conditions_only=True)
    known = identified(robot, tables, data.given)
    position = known.model.position(known.estimate, data.rows)
    jacobian = known.model.position_jacobian(known.estimate, data.rows)
    variance = np.einsum("nai,ij,naj->na", jacobian, known.covariance, jacobian)
    asked = pd.read_csv(path)
    for i, axis in enumerate("xyz"):
        asked[f"{axis}_mm"] = 1e3 * position[:, i]
    for i, axis in enumerate("xyz"):
        asked[f"sd_{axis}_mm"] = 1e3 * np.sqrt(variance[:, i])
    return asked
