"""calflow itself: geometry, and whatever causes the diagnosis names, in a run folder that is used again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from real_data import columns

from calflow.measurements.measurements import Measurements
from calflow.runs.calibrated_run import CalibratedRun
from calflow.runs.run import run
from calflow.study import load_study
from prior_methods.method import Fitted, processor_seconds

STUDY = """\
name = "calflow"
robot = "robot.toml"
workflow = "diagnose"
seed = 10
effects = ["geometry"]

[measurements]
file = "measurements.csv"

[split]
holdout = 0
"""


@dataclass(frozen=True)
class Calflow:
    """Identify and diagnose; runs is the folder in which a folder a set of rows is kept."""

    runs: Path
    name: str = "calflow, identify and diagnose"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    def fit(self, train: Measurements) -> Fitted:
        """Run a study of these rows, or read the run that was made of them; its time is that of the first run."""
        folder = self._written(train)
        seconds, started = folder / "processor_seconds.txt", processor_seconds()
        run(load_study(folder), folder / "run")
        if not seconds.exists():
            seconds.write_text(f"{processor_seconds() - started:.2f}\n", encoding="utf-8")

        def positions(rows: Measurements) -> np.ndarray:
            known = CalibratedRun.of(folder / "run").known(rows.given)
            return known.model.position(known.estimate, rows.on(known.model.robot).rows)

        return Fitted(positions, float(seconds.read_text(encoding="utf-8")))

    def _written(self, train: Measurements) -> Path:
        """Write the rows as a study, in a folder that their content names."""
        rows = columns(train).to_csv(index=False)
        folder = self.runs / hashlib.sha256(rows.encode()).hexdigest()[:12]
        folder.mkdir(parents=True, exist_ok=True)
        train.robot.to_toml(folder / "robot.toml")
        (folder / "measurements.csv").write_text(rows, encoding="utf-8")
        (folder / "study.toml").write_text(STUDY, encoding="utf-8")
        return folder
