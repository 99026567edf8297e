"""What the sections are written from: the study, its measurements and the tables, with what is derived from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.effects.cause import Cause
from calflow.estimation.accuracy import distances
from calflow.estimation.calibrated import Identified, calibrated, with_maps_held
from calflow.faults import corrected
from calflow.files.tables import Tables
from calflow.measurements.measurements import Measurements
from calflow.report.findings import step_words
from calflow.report.words import effect_words
from calflow.study import Study

MEAN_OF_NOISE = float(np.sqrt(8 / np.pi))  # mean length of a vector of three unit normals


@dataclass(frozen=True)
class ModelAccuracy:
    """A model's accuracy on one split [mm]; label says what the model has more than the one before."""

    model: str
    label: str
    n: int
    mean: float
    rms: float
    max: float


@dataclass(frozen=True)
class Material:
    """Study, measurements without the rows that are left out, the best model that was found, and all tables."""

    study: Study
    data: Measurements
    known: Identified
    tables: Tables
    run_folder: Path

    @staticmethod
    def of(study: Study, tables: Tables, run_folder: Path) -> Material:
        """Read the measurements and rebuild the fitted model."""
        data = corrected(study.measurements(), tables["identify/faults.csv"])
        known = calibrated(study.robot, tables, data.given)
        used = data.only(data.train | data.held_out)
        return Material(study, used.on(known.model.robot), known, tables, run_folder)

    @cached_property
    def sampled(self) -> tuple[Identified, tuple[Cause, ...]]:
        """The model of which the stage sample drew, and the causes that it held at their estimates."""
        return with_maps_held(self.known)

    @property
    def title(self) -> str:
        """What the report is called."""
        return self.study.file.title or self.study.name

    @cached_property
    def held(self) -> np.ndarray:
        """Which rows no fit has seen, shape (n_rows,)."""
        return self.data.held_out

    @property
    def judged(self) -> np.ndarray:
        """The rows by which the model is judged: those held out, else those fitted."""
        return self.held if self.held.any() else self.data.train

    @cached_property
    def error(self) -> np.ndarray:
        """Predicted minus measured positions, shape (n_rows, 3) [mm]."""
        return _errors(latest(self.tables, "residuals"))

    @property
    def error_before(self) -> np.ndarray:
        """The same of the study's own model, before causes were added to it."""
        return _errors(self.tables["identify/residuals.csv"])

    @cached_property
    def distance(self) -> np.ndarray:
        """Length of each row's error, shape (n_rows,) [mm]."""
        return distances(self.error)

    @cached_property
    def sigma(self) -> np.ndarray:
        """Noise of each row per axis, shape (n_rows,) [mm]."""
        return 1e3 * self.known.noise(self.data).sigma

    @property
    def noise_floor(self) -> float | None:
        """Mean error that noise alone would give in the judged rows [mm]; None where only the fit tells the noise."""
        if not self.known.noise_known:
            return None
        return MEAN_OF_NOISE * float(self.sigma[self.judged].mean())

    @cached_property
    def model_sd(self) -> float:
        """How sure the calibrated model's own position is: root mean square over the judged rows [mm]."""
        jacobian = self.known.model.point_jacobian(self.known.estimate, self.data.rows[:, self.judged])
        variance = np.einsum("nai,ij,naj->n", jacobian, self.known.covariance, jacobian, optimize=True)
        return 1e3 * float(np.sqrt(variance.mean()))


def _errors(residuals: pd.DataFrame) -> np.ndarray:
    used = residuals["split"].isin(["train", "holdout"])  # the others were left out as faulty
    return residuals.loc[used, ["dx_mm", "dy_mm", "dz_mm"]].to_numpy(dtype=float)


def latest(tables: Tables, name: str) -> pd.DataFrame:
    """Return a table of the best model there is: diagnose's, which has the causes that were found, else identify's."""
    extended = f"diagnose/{name}.csv"
    return tables[extended] if extended in tables else tables[f"identify/{name}.csv"]


def split_judged(accuracy: pd.DataFrame) -> str:
    """Return the split by which models are judged: holdout where there is one."""
    return "holdout" if (accuracy["split"] == "holdout").any() else "train"


def steps(accuracy: pd.DataFrame, split: str) -> list[ModelAccuracy]:
    """Return the models of accuracy.csv in their order."""
    rows = accuracy[accuracy["split"] == split]
    found: list[ModelAccuracy] = []
    for row in rows.to_dict("records"):
        label = _label(row["model"], found[-1].model if found else "")
        found.append(ModelAccuracy(row["model"], label, row["n"], row["mean_mm"], row["rms_mm"], row["max_mm"]))
    return found


def gathered(found: list[ModelAccuracy], own: int) -> list[ModelAccuracy]:
    """Return steps of which the first are the study's own and the others, if there are several, are drawn together."""
    added = len(found) - own
    return found if added < 2 else [*found[:own], replace(found[-1], label=f"+ {added} causes")]


def item(summary: pd.DataFrame, name: str) -> str:
    """Return an item of a summary table as text, or '' where it is not there."""
    found = summary.loc[summary["item"] == name, "value"]
    return str(found.iloc[0]) if len(found) else ""


def lack_of_fit(summary: pd.DataFrame) -> float:
    """Return how many times the noise the model leaves; nan where the noise was estimated from the fit itself."""
    if item(summary, "noise_source") == "estimated":
        return float("nan")
    return float(np.sqrt(float(item(summary, "reduced_chi2"))))


def _label(model: str, before: str) -> str:
    if model == "nominal":
        return "nominal robot"
    if before and model.startswith(f"{before} + "):
        return f"+ {step_words(model[len(before) + 3 :])}"
    return effect_words(model)
