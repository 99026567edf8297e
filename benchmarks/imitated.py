"""What the identified model cannot imitate of a displacement: the part of it that a diagnosis can see."""

from __future__ import annotations

import numpy as np

from calflow.estimation.accuracy import error_jacobian
from calflow.estimation.model_tables import calibrated
from calflow.files.tables import Results
from calflow.study import Study


def left_over(study: Study, results: Results, moved: np.ndarray) -> np.ndarray:
    """Return what is left at the training rows (n_train, 3) [m] of a displacement of all the file's rows (n_rows, 3) [m].

    All rows weigh alike, and what is left is across all that small changes of the model's parameters do.
    """
    data = study.measurements()
    known = calibrated(study.robot, results.of({"identify"}), data.given)
    train = data.on(known.model.robot).only(data.train)
    flat = moved[train.table["line"].to_numpy(int) - 2].ravel()
    slope = error_jacobian(known.model, known.estimate, train).reshape(len(flat), -1)
    slope = slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)
    return (flat - slope @ np.linalg.lstsq(slope, flat, rcond=1e-9)[0]).reshape(-1, 3)
