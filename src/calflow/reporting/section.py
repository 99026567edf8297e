"""What a section of the report is, how sections are found, and the material that they are written from.

A section is each `Section` that a file in sections/ defines. Its material: what was asked, the measurements, the calibrated model,
and what follows from them.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calflow.deployment.figures_alone import Levels
from calflow.deployment.usability import (
    AT_THE_ROBOT,
    Advice,
    Certainty,
    Rule,
    accuracy_steps,
    errors_in,
    latest_certainty,
    mistake_unsettled,
    split_judged,
)
from calflow.effects.base import Cause, place_name
from calflow.estimation.accuracy import Accuracy, errors, judged_unit
from calflow.estimation.calibrated_model import (
    CalibratedModel,
    with_maps_held,
)
from calflow.estimation.parameters import FittedParameter, Parameters
from calflow.estimation.registration import in_measuring_frame
from calflow.files.tables import Results, Tables
from calflow.files.units import METRE, MeasurementUnit
from calflow.files.words import effect_words, mm
from calflow.measurements.measurements import Measurements
from calflow.reporting.blocks import Block
from calflow.robot.robot import Robot
from calflow.study import StudyFile

IDENTIFIED_PARAMETERS = "identify/parameters.csv"
DRAWN, WORST = 5_000, 100  # rows that figures show one by one: more dots would only hide each other


@dataclass(frozen=True)
class ModelAccuracy:
    """A model's accuracy on one split [unit]; name says what it is, or what it has more than the one before (added)."""

    model: str
    name: str
    n: int
    mean: float
    rms: float
    max: float
    added: bool = False
    unit: str = METRE.label

    @property
    def label(self) -> str:
        """The name, with a plus where it is what was added."""
        return f"+ {self.name}" if self.added else self.name


@dataclass(frozen=True)
class Material:
    """What was asked, of which robot, and what came of it: what the sections are written from.

    request is what a study file says, settings are those of each stage of the workflow, in their order; chain is the file of the
    sampled posterior. load returns the calibrated model and its measurements, and is called where a section asks for what no table
    tells: that section needs results of identify.
    """

    robot: Robot
    request: StudyFile
    workflow: str
    settings: Mapping[str, Mapping[str, Any]]
    results: Results
    load: Callable[[], tuple[CalibratedModel, Measurements]]
    chain: Path | None = None

    @cached_property
    def _loaded(self) -> tuple[CalibratedModel, Measurements]:
        calibrated, data = self.load()
        return replace(calibrated, field=None), data.only(data.train | data.held_out)

    @cached_property
    def certainty(self) -> Certainty:
        """How sure the best model is."""
        return latest_certainty(self.results)

    @property
    def data(self) -> Measurements:
        """The measurements, without the rows that are left out."""
        return self._loaded[1]

    @property
    def calibrated(self) -> CalibratedModel:
        """The best model that was found, without its residual field: pages tell of causes."""
        return self._loaded[0]

    @property
    def tables(self) -> Tables:
        """All tables by their path in the run folder."""
        return self.results.tables

    @cached_property
    def levels(self) -> Levels:
        """What may be given to the robot, and what it then misses by."""
        return Levels.of(self.calibrated, self.data)

    @cached_property
    def figures(self) -> list[FittedParameter]:
        """The parameters of the robot's figures, fitted anew where the model has more than these."""
        if not self.levels.left_out:
            return latest_parameters(self.results)
        return list(Parameters.fitted(self.levels.figures, self.levels.figures.covariance).rows)

    @cached_property
    def sampled(self) -> tuple[CalibratedModel, tuple[Cause, ...]]:
        """The model of which the stage sample drew, and the causes that it held at their estimates."""
        return with_maps_held(self.calibrated)

    @property
    def title(self) -> str:
        """What the report is called."""
        return self.request.title or self.request.name

    @cached_property
    def unit(self) -> MeasurementUnit:
        """The unit by which the model is judged."""
        return judged_unit([observation.units[0] for observation in self.calibrated.model.observations])

    @cached_property
    def held(self) -> np.ndarray:
        """Which rows no fit has seen, shape (n_rows,)."""
        return self.data.held_out

    @property
    def judged(self) -> np.ndarray:
        """The rows by which the model is judged: those held out, else those fitted, of values in its unit."""
        there = np.isfinite(self.distance)
        return (self.held if (self.held & there).any() else self.data.train) & there

    @cached_property
    def error(self) -> np.ndarray:
        """Predicted minus measured positions, nan where none was measured, shape (n_rows, 3) [mm]."""
        return _errors(latest(self.results, "residuals"))

    @property
    def error_before(self) -> np.ndarray:
        """The same of the study's own model, before causes were added to it."""
        return _errors(self.tables["identify/residuals.csv"])

    @cached_property
    def distance(self) -> np.ndarray:
        """Size of each row's error, shape (n_rows,) [unit]; nan where its values are in another."""
        return errors_in(_used(latest(self.results, "residuals")), self.unit)

    @cached_property
    def values(self) -> np.ndarray:
        """Predicted minus measured values in the unit by which the model is judged, (n_rows, n_axes) [unit]; nan elsewhere."""
        return np.asarray(self.unit.shown(errors(self.calibrated.model, self.calibrated.estimate, self.data)))

    @cached_property
    def length_error(self) -> np.ndarray:
        """Predicted minus measured length where a row has one alone, nan elsewhere, shape (n_rows,) [mm]."""
        whole = errors(self.calibrated.model, self.calibrated.estimate, self.data, METRE)
        return np.where(np.isnan(whole[:, 1]), 1e3 * whole[:, 0], np.nan)

    @cached_property
    def drawn(self) -> np.ndarray:
        """The rows that figures show one by one: all, or of very many some at random and those of the largest errors."""
        n = len(self.data)
        if n <= DRAWN:
            return np.arange(n)
        some = np.random.default_rng(0).choice(n, DRAWN, replace=False)  # markers and payloads may take turns
        return np.union1d(some, np.argpartition(np.nan_to_num(self.distance), -WORST)[-WORST:])

    @property
    def drawn_words(self) -> str:
        """Which rows figures show, where these are not all; with a space before it."""
        n = len(self.data)
        if len(self.drawn) == n:
            return ""
        return (
            f" Of {n:,} rows {DRAWN:,} are drawn, at random, and the {WORST} of the largest errors; means are of all."
        )

    @cached_property
    def place(self) -> np.ndarray:
        """Where the marker was: as measured, or as predicted where no position was, shape (n_rows, 3) [m]."""
        model = self.calibrated.model
        here = in_measuring_frame(model.observations, self.data)
        place = model.point(self.calibrated.estimate, self.data.conditions)
        if here.any():
            place[here] = self.data.position[here]
        return place

    @cached_property
    def sigma(self) -> np.ndarray:
        """Noise of each row per axis, shape (n_rows,) [unit]; nan where its values are in another."""
        noise = self.calibrated.noise(self.data)
        return np.where(noise.in_unit(self.unit), self.unit.scale * noise.sigma, np.nan)


def _errors(residuals: pd.DataFrame) -> np.ndarray:
    return _used(residuals)[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(dtype=float)


def _used(residuals: pd.DataFrame) -> pd.DataFrame:
    """The rows that were not left out as faulty."""
    return residuals[residuals["split"].isin(["train", "holdout"])]


def latest(results: Results, name: str) -> pd.DataFrame:
    """Return a table of the best model there is: diagnose's, which has the causes that were found, else identify's."""
    extended = f"diagnose/{name}.csv"
    return results.tables[extended] if extended in results else results.tables[f"identify/{name}.csv"]


def latest_parameters(results: Results) -> list[FittedParameter]:
    """Return the parameters of the best model there is."""
    extended = "diagnose/parameters.csv"
    return results.rows(extended if extended in results else IDENTIFIED_PARAMETERS, FittedParameter)


def model_steps(results: Results, split: str) -> list[ModelAccuracy]:
    """Return the models on the way to the best one, in their order."""
    rows = [row for row in accuracy_steps(results) if row.split == split]
    return [
        ModelAccuracy(row.model, _name(row), row.n, *row.figures, row.step > 1, row.unit)
        for row in rows if row.unit == rows[0].unit  # that by which models are judged
    ]  # fmt: skip


def study_steps(results: Results, split: str) -> list[ModelAccuracy]:
    """Return those of them that the study asks for, before any cause was added."""
    return model_steps(results.of({"identify"}), split)


def gathered_steps(results: Results) -> list[ModelAccuracy]:
    """Return the models on the split by which they are judged, the causes that were added drawn together."""
    split = split_judged(results)
    return gathered(model_steps(results, split), len(study_steps(results, split)))


def accuracy_frame(steps: list[ModelAccuracy]) -> pd.DataFrame:
    """Return models with their accuracy as a table for whoever wants a figure's numbers."""
    unit = steps[0].unit if steps else METRE.label
    return pd.DataFrame(
        [(step.label, step.n, step.mean, step.rms, step.max) for step in steps],
        columns=["model", "rows", *(f"{name}_{unit}" for name in ("mean", "rms", "max"))],
    )


def error_axis(unit: str) -> str:
    """Return what an axis of errors in a unit is labelled."""
    return f"{'tool-position error' if unit == METRE.label else 'error of what was measured'} [{unit}]"


def gathered(steps: list[ModelAccuracy], own: int) -> list[ModelAccuracy]:
    """Return steps of which the first are the study's own and the others, if there are several, are drawn together."""
    added = len(steps) - own
    return steps if added < 2 else [*steps[:own], replace(steps[-1], name=f"{added} causes", added=True)]


def _name(row: Accuracy) -> str:
    if not row.effect:
        return "nominal robot"
    return place_name(row.effect, row.joint or 0, row.part) if row.part else effect_words(row.effect)


def headline(steps: list[ModelAccuracy], split: str) -> str:
    """Say in one sentence what calibration gained."""
    first, last = steps[0], steps[-1]
    seen = "that no fit has seen" if split == "holdout" else "used for the fit (none were held out)"
    if len(steps) == 1:
        return f"At poses {seen}, the nominal robot is off by {mm(first.mean)} {first.unit} on average."
    verb, unit = "reduces" if last.mean < first.mean else "increases", last.unit
    error = "the tool-position error" if unit == METRE.label else "the error of what was measured"
    return (
        f"At poses {seen}, calibration {verb} {error} from {mm(first.mean)} {unit} to {mm(last.mean)} {unit} "
        f"on average, and the largest from {mm(first.max)} {unit} to {mm(last.max)} {unit}."
    )


WRONG = 2  # urgency up to which something is wrong or missing; what could be better may be left


@dataclass(frozen=True)
class Section:
    """A part of the report: where it stands, the tables and documents it cannot do without, how it is written, what it advises.

    rules turn them into advice for the first page; they apply where they are there. worth_telling says
    whether the section has anything to say, asked whether the study asks for it.
    """

    order: int
    title: str
    needs: tuple[str, ...]
    write: Callable[[Material], list[Block]]
    rules: tuple[Rule, ...] = ()
    worth_telling: Callable[[Results], bool] = lambda results: True
    asked: Callable[[StudyFile], bool] = lambda request: True

    def is_served(self, results: Results) -> bool:
        """Whether its tables are there."""
        return all(path in results for path in self.needs)

    def tells(self, material: Material) -> bool:
        """Whether its tables are there and hold something to tell."""
        results = material.results
        return self.is_served(results) and self.asked(material.request) and self.worth_telling(results)


def sections() -> list[Section]:
    """Return all sections in their order."""
    from calflow.reporting import sections as folder

    modules = [
        importlib.import_module(f"{folder.__name__}.{module.name}") for module in pkgutil.iter_modules(folder.__path__)
    ]
    every = dict.fromkeys(part for module in modules for part in vars(module).values() if isinstance(part, Section))
    return sorted(every, key=lambda section: section.order)


def advise(urgency: int, sentence: str, where: object = True, effort: int = AT_THE_ROBOT) -> list[Advice]:
    """Return advice, where there is reason for it."""
    return [Advice(urgency, sentence, effort)] if where else []


def advice(every: Sequence[Section], results: Results) -> list[Advice]:
    """Return what all sections advise, the most urgent first, of those alike what takes least; an unsettled mistake alone."""
    if unsettled := mistake_unsettled(results):
        return unsettled
    items = [
        item for section in every if section.is_served(results) for rule in section.rules for item in rule(results)
    ]
    return sorted(items, key=lambda item: (item.urgency, item.effort))
