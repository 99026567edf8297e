"""The real FANUC's held-out error over random splits: 24 poses are few, and one split alone says little.

    python benchmarks/splits.py     (CALFLOW_DATA)

Twelve random splits, and one pose left out at a time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.estimation.accuracy import errors
from calflow.estimation.extrapolation import extrapolation
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.noise import measured_noise
from calflow.estimation.registration import registered
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.observations import observations
from calflow.study import load_study

STUDY = Path(__file__).parents[1] / "studies" / "fanuc-r2000" / "study.toml"


def main() -> None:
    """Print one line a split."""
    study = load_study(STUDY)
    measured = study.measurements()
    data = replace(measured, table=measured.table.drop(columns="split"))
    print("split  held-out mean mm  held-out readings beyond the fitted ones")
    splits = []
    for seed in range(12):
        split = data.split(study.file.split.holdout, seed)
        splits.append(heldout(split, study.file.effects))
        beyond = ", ".join(f"joint {joint}" for joint in extrapolation(split))
        print(f"{seed:5}  {splits[-1].mean():16.3f}  {beyond}")
    print(
        f"mean over splits {np.mean([s.mean() for s in splits]):.3f}, median {np.median([s.mean() for s in splits]):.3f}"
    )
    poses = data.table["pose"].unique()
    one_out = [heldout(Measurements(data.robot, data.table.assign(
        split=np.where(data.table["pose"] == pose, "holdout", "train"))), study.file.effects).mean() for pose in poses]  # fmt: skip
    print(f"one pose left out at a time: mean {np.mean(one_out):.3f}, largest {np.max(one_out):.3f}")


def heldout(data: Measurements, effects: tuple[str, ...]) -> np.ndarray:
    """Held-out errors [mm], shape (n_rows,)."""
    train = data.only(data.train)
    robot, observed = registered(data.robot, observations(train), train)
    data = data.on(robot)
    model = build(robot, effects, data.given, observed)
    level = measured_noise(data).only(data.train)
    result = fit_reweighted(model, data.only(data.train), level, model.nominal[None], "linear")[0]
    return 1e3 * np.linalg.norm(errors(model, result.estimate, data), axis=1)[~data.train]


if __name__ == "__main__":
    main()
