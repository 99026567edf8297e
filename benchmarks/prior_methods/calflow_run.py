"""calflow itself: geometry, whatever causes the diagnosis names, and a residual field; in a run folder that is used again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from real_data import columns

from calflow.calibration import Calibration
from calflow.estimation.field_gain import gainful_field
from calflow.estimation.identification import fit_effects
from calflow.measurements.measurements import Measurements
from calflow.runs.run import run
from calflow.study import load_study
from prior_methods.method import Fitted, Predictor, processor_seconds, timed

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
    residual_field: bool = False

    @property
    def name(self) -> str:
        """What a table calls it."""
        return "calflow with residual_field (not physical)" if self.residual_field else "calflow, identify and diagnose"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    def fit(self, train: Measurements) -> Fitted:
        """Run a study of these rows, or read the run that was made of them; its time is that of the first run."""
        folder = self._written(train)
        seconds, before = folder / f"seconds{'_field' * self.residual_field}.txt", folder / "seconds.txt"
        started = processor_seconds()
        run(load_study(folder), folder / "run")
        if not seconds.exists():
            reused = float(before.read_text(encoding="utf-8")) if before.exists() else 0.0
            seconds.write_text(f"{reused + processor_seconds() - started:.2f}\n", encoding="utf-8")

        def positions(rows: Measurements) -> np.ndarray:
            known = Calibration.load(folder / "run").later(rows.given)
            packed = counted(rows, train).on(known.model.robot).conditions
            return known.model.position(known.estimate, packed) + known.field_correction(packed)  # as the device saw it

        return Fitted(positions, float(seconds.read_text(encoding="utf-8")))

    def _written(self, train: Measurements) -> Path:
        """Write the rows as a study, in a folder that their content names."""
        rows = columns(train).to_csv(index=False)
        folder = self.runs / hashlib.sha256(rows.encode()).hexdigest()[:12]
        folder.mkdir(parents=True, exist_ok=True)
        train.robot.to_toml(folder / "robot.toml")
        (folder / "measurements.csv").write_text(rows, encoding="utf-8")
        asked = f"residual_field = {str(self.residual_field).lower()}\n"
        (folder / "study.toml").write_text(asked + STUDY, encoding="utf-8")
        return folder


@dataclass(frozen=True)
class GeometryField:
    """Geometry, and the residual field of what it leaves, where that gains something."""

    name: str = "geometry with residual_field (not physical)"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit both."""
        train = replace(train, table=train.table.assign(split="train"))
        known = fit_effects(train, ("geometry",), starts=1).known
        known = replace(known, field=gainful_field(known, train.on(known.model.robot))[0])

        def positions(rows: Measurements) -> np.ndarray:
            packed = rows.on(known.model.robot).conditions
            return known.model.position(known.estimate, packed) + known.field_correction(packed)

        return positions


def counted(rows: Measurements, train: Measurements) -> Measurements:
    """Return rows with the places in measuring order that they have beside the training rows alone, as their file counts them."""
    if "order" not in train.table:
        return rows
    place = np.searchsorted(np.sort(train.table["order"]), rows.table["order"], side="right")
    return replace(rows, table=rows.table.assign(order=place.astype(float)))
