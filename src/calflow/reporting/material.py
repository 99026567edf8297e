"""The material of a report: request, measurements, calibrated model, and quantities derived from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calflow.deployment.figures_alone import FiguresAlone, Levels
from calflow.deployment.run_outcome import RunOutcome
from calflow.effects.cause import Cause
from calflow.effects.geometry import Geometry
from calflow.estimation.accuracy import errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import errors_in, tested_rows
from calflow.estimation.model_tables import ModelObservation
from calflow.estimation.registration import in_measuring_frame
from calflow.files.deferred import pd
from calflow.files.units import MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.observations.base import observation_kinds
from calflow.reporting.promised import Promised
from calflow.robot.robot import Robot
from calflow.study import StudyFile

DRAWN, WORST = 5_000, 100  # rows that figures show individually: more dots would only overlap


@dataclass(frozen=True)
class Material(RunOutcome):
    """The request, robot and outcome of a run, from which the sections are written.

    request: the study file; settings: those of each stage in order; chain: file of the sampled posterior;
    stopped: how stages ended that are not done (see `StageEntry`).
    load returns the calibrated model and its measurements; it is called where a section needs more than tables, and
    requires results of identify.
    """

    robot: Robot
    request: StudyFile
    workflow: str
    settings: Mapping[str, Mapping[str, Any]]
    load: Callable[[], tuple[CalibratedModel, Measurements]]
    chain: Path | None = None
    stopped: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _loaded(self) -> tuple[CalibratedModel, Measurements]:
        calibrated, data = self.load()
        return replace(calibrated, field=None), data.only(data.train | data.held_out)

    @property
    def data(self) -> Measurements:
        """The measurements without the rows left out."""
        return self._loaded[1]

    @property
    def calibrated(self) -> CalibratedModel:
        """The best model, without its residual field, since sections describe causes."""
        return self._loaded[0]

    @cached_property
    def levels(self) -> Levels:
        """The levels of effort with their errors."""
        return Levels.read(self.calibrated.model, self.results)

    @property
    def has_figures(self) -> bool:
        """Whether any figure of the robot was fitted."""
        return any(row.effect == Geometry.id for row in self.fitted_parameters)

    @cached_property
    def figures(self) -> FiguresAlone:
        """The robot's figures, fitted alone where the model has further effects."""
        if not self.levels.left_out:
            return FiguresAlone(self.calibrated.model, tuple(self.fitted_parameters))
        return self.levels.figures

    @cached_property
    def sampled(self) -> tuple[CalibratedModel, tuple[Cause, ...]]:
        """The model from which the stage sample drew, and the causes fixed at their estimates."""
        return self.calibrated.with_maps_held()

    @property
    def title(self) -> str:
        """The title of the report."""
        return self.request.title or self.request.name

    @cached_property
    def unit(self) -> MeasurementUnit:
        """The unit in which the model is judged."""
        return self.calibrated.unit

    @cached_property
    def held(self) -> np.ndarray:
        """Mask of held-out rows, shape (n_rows,)."""
        return self.data.held_out

    @cached_property
    def largest(self) -> pd.Series:
        """The largest error of each judged pose [unit], in descending order."""
        rows = _used(self.residuals.table).assign(error=self.distance)
        judged = rows[rows["split"] == self.certainty.split].dropna(subset="error")
        return judged.groupby("pose")["error"].max().sort_values(ascending=False, kind="stable")

    @cached_property
    def error(self) -> np.ndarray:
        """Predicted minus measured positions, nan where none was measured, shape (n_rows, 3) [mm]."""
        return _used(self.residuals.table)[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(dtype=float)

    @cached_property
    def distance(self) -> np.ndarray:
        """Norm of each row's error, shape (n_rows,) [unit]; nan where its values have another unit, or it may be before a step."""
        return np.where(self._undecided, np.nan, errors_in(_used(self.residuals.table), self.certainty.unit))

    @cached_property
    def tested(self) -> pd.DataFrame:
        """Pose, error and predicted limit [unit] of held-out rows."""
        return tested_rows(self.calibrated, self.data, self.distance)

    @cached_property
    def values(self) -> np.ndarray:
        """Predicted minus measured values in the judged unit, (n_rows, n_axes) [unit]; nan as of `distance`."""
        values = self.unit.shown(errors(self.calibrated.model, self.calibrated.estimate, self.data))
        return np.where(self._undecided[:, None], np.nan, values)

    @cached_property
    def untold(self) -> int:
        """Number of held-out poses of which the fit does not tell whether they are before a step, so that none is judged."""
        held = pd.Series(self._undecided[self.held])
        return int(held.groupby(self.data.table["pose"].to_numpy()[self.held]).all().sum())

    @cached_property
    def _undecided(self) -> np.ndarray:
        """Mask of the rows of which the fit does not tell whether they are before a step, (n_rows,)."""
        return self.calibrated.model.undecided(self.data)

    @cached_property
    def drawn(self) -> np.ndarray:
        """The rows that figures show individually: all, or a random sample and those with the largest errors."""
        n = len(self.data)
        if n <= DRAWN:
            return np.arange(n)
        some = np.random.default_rng(0).choice(n, DRAWN, replace=False)  # markers and payloads may take turns
        return np.union1d(some, np.argpartition(np.nan_to_num(self.distance), -WORST)[-WORST:])

    @property
    def drawn_words(self) -> str:
        """A phrase on which rows figures show, unless they show all; with a leading space."""
        n = len(self.data)
        if len(self.drawn) == n:
            return ""
        return (
            f" Of {n:,} rows {DRAWN:,} are drawn, at random, and the {WORST} of the largest errors; means are of all."
        )

    @cached_property
    def place(self) -> np.ndarray:
        """The marker's position: measured, or predicted where none was measured, shape (n_rows, 3) [m]."""
        model = self.calibrated.model
        here = in_measuring_frame(model.observations, self.data)
        place = model.point(self.calibrated.estimate, self.data.conditions)
        if here.any():
            place[here] = self.data.position[here]
        return place

    @cached_property
    def promised(self) -> Promised:
        """The expected errors within the joints' limits; only where some lengths were measured."""
        return Promised.of(self.calibrated, self.data)

    @property
    def is_of_positions(self) -> bool:
        """Whether positions or poses alone were measured, so that errors are the tool's."""
        rows, kinds = self.results.rows("identify/observations.csv", ModelObservation), observation_kinds()
        return all(kinds[row.kind].from_outside for row in rows)

    @cached_property
    def sigma(self) -> np.ndarray:
        """Noise of each row per axis, shape (n_rows,) [unit]; nan where its values have another unit."""
        noise = self.calibrated.noise(self.data)
        return np.where(noise.in_unit(self.unit), self.unit.scale * noise.sigma, np.nan)


def _used(residuals: pd.DataFrame) -> pd.DataFrame:
    """Return the residuals of rows not left out as faulty."""
    return residuals[residuals["split"].isin(["train", "holdout"])]
