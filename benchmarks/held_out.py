"""What a run says of its held-out poses: errors before and after the causes, and whether its intervals cover them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from calflow.calibration import Calibration
from calflow.deployment.prediction import predict_rows
from calflow.files.tables import Results
from calflow.runs.given_rows import rows_to_predict

WITHIN = 1.96  # standard deviations, of a 95 % interval


def predicted_sd(run: Path, rows: Path) -> np.ndarray:
    """Return the standard deviations that a run predicts of rows (n, 3) [mm]."""
    calibration = Calibration.load(run)
    return 1e3 * predict_rows(calibration, rows_to_predict(calibration, rows).data).sd


def errors(results: Results) -> dict[str, object]:
    """Return mean and largest held-out error [mm] of the identified and of the last model, and the least largest one on the way."""
    way = results.tables["diagnose/accuracy.csv"]
    way = way[(way["split"] == "holdout") & (way["step"] >= results.tables["identify/accuracy.csv"]["step"].max())]
    if way.empty:
        return {}
    way = way.sort_values("step")
    first, last = way.iloc[0], way.iloc[-1]
    return {
        "before_mean_mm": first["mean_mm"],
        "before_max_mm": first["max_mm"],
        "after_mean_mm": last["mean_mm"],
        "after_max_mm": last["max_mm"],
        "least_max_mm": way["max_mm"].min(),
    }


def covered(run: Path, measurements: Path, results: Results) -> dict[str, object]:
    """Return the share of held-out coordinates within 95 % intervals of the prediction, and how many there are.

    The prediction's standard deviations are those that `calflow predict` says; the device's noise, which they leave out where
    it is known apart from the fit, is added.
    """
    left = results.tables["diagnose/residuals.csv"]
    left = left[left["split"] == "holdout"]
    if left.empty:
        return {}
    table = pd.read_csv(measurements)
    asked = table.iloc[left["line"] - 2]
    rows = run.parent / "rows_to_predict.csv"
    asked.drop(columns=["x_mm", "y_mm", "z_mm", "split", "sigma_mm"], errors="ignore").to_csv(rows, index=False)
    sd = predicted_sd(run, rows)
    (noise,) = results.documents["diagnose/summary.json"]["noise"]
    if noise["source"] != "estimated":
        own = asked["sigma_mm"].to_numpy()[:, None] if "sigma_mm" in asked else 1e3 * noise["sigma"]
        sd = np.hypot(sd, own)
    inside = np.abs(left[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()) < WITHIN * sd
    return {"covered": float(inside.mean()), "coordinates": inside.size}
