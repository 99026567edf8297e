"""Accuracy: how far predicted positions are from measured ones."""

from __future__ import annotations

import numpy as np

from calflow.measurements.measurements import Measurements
from calflow.model import Model


def errors(model: Model, estimate: np.ndarray, measured: Measurements) -> np.ndarray:
    """Return predicted minus measured positions, shape (n_rows, 3) [m]."""
    return model.position(estimate, measured.rows) - measured.position


def accuracy(name: str, error: np.ndarray, measured: Measurements) -> list[dict[str, object]]:
    """Return one row a split of the table accuracy.csv: model, split, n, mean_mm, rms_mm, max_mm."""
    distance = 1e3 * np.linalg.norm(error, axis=1)
    rows = []
    for split in ("train", "holdout"):
        part = distance[(measured.table["split"] == split).to_numpy()]
        if len(part):
            rows.append({"model": name, "split": split, "n": len(part), "mean_mm": part.mean(),
                         "rms_mm": np.sqrt((part**2).mean()), "max_mm": part.max()})  # fmt: skip
    return rows
