"""Outcome of a run: its tables and summaries as values; those of the best model from diagnose, else identify."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from calflow.deployment.figures_alone import FIGURES, LEVELS, AloneParameter, EffortLevel
from calflow.deployment.in_space import IN_SPACE, SpaceError
from calflow.design.discrimination import NextPose, SeparationRow
from calflow.diagnosis.cause_tables import CandidateRow, CauseProbability, CurvePoint, ModelRow
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.findings import Finding
from calflow.diagnosis.replication import CarriedAccuracy, ConfirmedCause, ConfirmedPoint
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.certainty import Certainty
from calflow.estimation.error_model import SmoothAmplitude
from calflow.estimation.identifiability import Correlation, Counted, Redundant, Statement
from calflow.estimation.lack_of_fit import NoiseDoubt
from calflow.estimation.leverage import JudgedResidual
from calflow.estimation.model_tables import FitSummary, IdentifySummary, ModelEffect, ModelObservation, Placed
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.parameters import Covariances, FittedParameter
from calflow.estimation.residual_field import POSES, FieldAccuracy, FieldPose
from calflow.faults.base import FaultyRow
from calflow.files.tables import Kind, Results, Row, Tables, TypedTable, to_frame
from calflow.files.words import listed, plural
from calflow.sampling.posterior import ChainSummary
from calflow.sampling.task_points import TaskSummary

FAULTS = "identify/faults.csv"
MORE_THAN_NOISE = "The error left is larger than measurement noise explains"
Figures = tuple[float, float, float]  # mean, RMS and largest error


class _Table(cached_property[TypedTable[Row]]):
    """A table of an outcome, by its path or, for the best model, its name; without rows where it is missing."""

    def __init__(self, meaning: str, name: str, row_type: type[Row]) -> None:
        def table(of: RunOutcome) -> TypedTable[Row]:
            path, tables = of.path_of(name), of.results.tables
            return TypedTable(tables[path] if path in tables else to_frame((), row_type), row_type, path)

        super().__init__(table)
        self.__doc__, self.name, self.row_type = meaning, name, row_type


def _summary(meaning: str, name: str, kind: type[Kind]) -> cached_property[Kind]:
    """Declare a summary of an outcome, by its path or, for the best model, its name."""
    summary = cached_property[Kind](lambda of: of.results.document(of.path_of(name), kind))
    summary.__doc__ = meaning
    return summary


@dataclass(frozen=True)
class RunOutcome:
    """The outcome of a run, or of a calibration in Python; results: all tables and summaries by path."""

    results: Results = field(repr=False)

    accuracy = _Table("The errors of each model on the way, on fitted and on held-out rows.", "accuracy.csv", Accuracy)
    residuals = _Table("What the model leaves of each row.", "residuals.csv", JudgedResidual)
    fitted_parameters = _Table("The parameters of the best model.", "parameters.csv", FittedParameter)
    identified_parameters = _Table("Those that were identified.", "identify/parameters.csv", FittedParameter)
    faults = _Table(
        "The gross mistakes in the measurements that were put right or left out before any fit.", FAULTS, FaultyRow
    )
    statements = _Table("What the data do not tell.", "identify/identifiability.csv", Statement)
    correlations = _Table("The most correlated parameters.", "identify/correlations.csv", Correlation)
    counted = _Table("Which parameters a model with fewer keeps.", "identify/count.csv", Counted)
    redundant = _Table("Figures of full origins that are no parameters.", "identify/redundant.csv", Redundant)
    placement = _Table("Where base, markers and tool are.", "identify/placement.csv", Placed)
    findings = _Table(
        "Faults of the data, causes, and what no cause explains, best first; none where nothing is lacking.",
        "diagnose/findings.csv",
        Finding,
    )
    candidates = _Table(
        "Every cause that was tested, and why others were not.", "diagnose/candidates.csv", CandidateRow
    )
    next_poses = _Table(
        "The poses to measure next, so that findings are told from their rivals.", "diagnose/next_poses.csv", NextPose
    )
    separations = _Table(
        "How far each finding is from each rival, and what to do about it.", "diagnose/separations.csv", SeparationRow
    )
    models_in_reach = _Table(
        "The models near what was found that may be right as well.", "diagnose/models_in_reach.csv", ModelRow
    )
    cause_probabilities = _Table(
        "How probable each cause of these models is.", "diagnose/cause_probabilities.csv", CauseProbability
    )
    curves = _Table("The course of what was found over what it depends on.", "diagnose/curves.csv", CurvePoint)
    effort_levels = _Table("What the robot misses by with each level of effort.", LEVELS, EffortLevel)
    in_space = _Table("How far off the tool is in space, where cameras measured.", IN_SPACE, SpaceError)
    summary = _summary(
        "How the identification ended: noise, lack of fit, what the data determine, and the solver.",
        "identify/summary.json",
        IdentifySummary,
    )
    diagnosis_summary = _summary("How the diagnosis ended.", "diagnose/summary.json", DiagnosisSummary)
    fit_summary = _summary("Noise, lack of fit and solver of the model.", "summary.json", FitSummary)
    certainty = _summary("How sure the best model is.", "certainty.json", Certainty)
    chain_summary = _summary("How the sampling ended.", "sample/summary.json", ChainSummary)

    @property
    def is_of_lengths(self) -> bool:
        """Whether errors are expected in millimetres: some lengths were measured."""
        return self.summary.new_poses_mm is not None

    @property
    def no_gain(self) -> float:
        """Share of the measured rows without a certain gain; 0 where no lengths were measured, as base and tool are then taught."""
        return self.certainty.no_gain if self.is_of_lengths else 0.0

    def path_of(self, name: str) -> str:
        """Return a path unchanged, and for a name the best model's path: in diagnose where it extended the model."""
        if "/" in name:
            return name
        return f"diagnose/{name}" if f"diagnose/{name}" in self.results else f"identify/{name}"

    @property
    def tables(self) -> Tables:
        """All tables by their path in the run folder."""
        return self.results.tables

    @cached_property
    def task(self) -> TaskSummary | None:
        """How accurate the robot is where it works; None where the study names no task."""
        path = "sample/task_summary.json"
        return self.results.document(path, TaskSummary) if path in self.results else None

    @property
    def split_judged(self) -> Literal["train", "holdout"]:
        """The split on which models are judged: holdout where there is one."""
        return "holdout" if any(row.split == "holdout" for row in self.accuracy) else "train"

    def steps_on(self, split: str) -> list[Accuracy]:
        """Return the models leading to the best one on a split, in order, in the unit in which they are judged."""
        rows = [row for row in self.accuracy if row.split == split]
        return [row for row in rows if row.unit == rows[0].unit]

    @property
    def judged_steps(self) -> list[Accuracy]:
        """The models on the split on which they are judged."""
        return self.steps_on(self.split_judged)

    @property
    def errors_before_and_now(self) -> tuple[Figures, Figures]:
        """The errors with the maker's figures and of the best model, on the split on which models are judged.

        Both exclude what the measuring device adds, where that is separable.
        """
        steps, levels = self.judged_steps, self.effort_levels
        before = (levels[0].mean, levels[0].rms, levels[0].max) if levels else steps[0].figures
        return before, steps[-1].figures

    @property
    def unexplained(self) -> list[Finding]:
        """Unexplained findings that depend on an input."""
        return [finding for finding in self.findings if finding.is_structure]

    @property
    def structure(self) -> str:
        """The inputs on which the unexplained error depends, in words; empty where nothing is unexplained."""
        inputs = [finding.inputs_in_words for finding in self.unexplained]
        if len(inputs) > 3:
            return f"{', '.join(inputs[:2])} and {plural(len(inputs) - 2, 'other input')}"
        return listed(inputs) if inputs else ""

    @property
    def noise_doubts(self) -> tuple[NoiseDoubt, ...]:
        """Stated noises that the measurements contradict, by identify and by diagnose."""
        return tuple(dict.fromkeys((*self.summary.noise_doubts, *self.fit_summary.noise_doubts)))

    @property
    def lack_of_fit_words(self) -> str:
        """A statement that the extended model leaves more than noise, and where most; empty where it does not."""
        if not any(finding.is_misfit for finding in self.findings):
            return ""
        worst = self.diagnosis_summary.worst
        where = f" It is {worst.words}." if worst else ""
        return f"{MORE_THAN_NOISE}.{where}"


_NAMED: Mapping[str, type] = {
    **{table.name: table.row_type for table in vars(RunOutcome).values() if isinstance(table, _Table)},
    "covariance.csv": Covariances,
    "errors.csv": SmoothAmplitude,
    "effects.csv": ModelEffect,
    "needed_conditions.csv": NeededCondition,
    FIGURES: AloneParameter,
    "identify/observations.csv": ModelObservation,
    "diagnose/faults.csv": FaultyRow,
    "diagnose/confirmation.csv": ConfirmedCause,
    "diagnose/confirmation_curves.csv": ConfirmedPoint,
    "diagnose/confirmation_accuracy.csv": CarriedAccuracy,
    "diagnose/confirmation_faults.csv": FaultyRow,
    POSES: FieldPose,
    "residual_field/accuracy.csv": FieldAccuracy,
}
# Row types of all tables of a calibration by path in a run; those of a model both stages write.
TABLES: Mapping[str, type] = {
    path: row_type
    for name, row_type in _NAMED.items()
    for path in ([name] if "/" in name else [f"identify/{name}", f"diagnose/{name}"])
}
