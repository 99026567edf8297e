"""The calibration: the result of identify and diagnose, on which all later commands build.

It is stored as the tables of a run folder (`results`), from which it can be restored without loss.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from calflow.deployment import check_poses, compensation, prediction, validation
from calflow.deployment import drift as drift_check
from calflow.deployment import export as exporting
from calflow.deployment.export import Export, Format
from calflow.deployment.figures_alone import Levels
from calflow.deployment.in_space import IN_SPACE, SpaceError, hand_eye_errors, space_rows
from calflow.deployment.run_outcome import TABLES, RunOutcome
from calflow.deployment.usability import no_better_in_space, warning
from calflow.deployment.validation import Sent, Station, Validation
from calflow.design.cell import Cell
from calflow.design.discrimination import Question, poses_table, questions, separations_table
from calflow.design.planned import (
    USUAL_DRIFT,
    Aim,
    Conditions,
    Order,
    Planned,
    Readings,
    Region,
    SelectionRequest,
    Task,
)
from calflow.design.selection import Selection, select
from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.cause_tables import candidates_table, cause_table, curves, models_table
from calflow.diagnosis.diagnosis import Diagnosis, accuracy_table, diagnosis_summary, extended_model, search_causes
from calflow.diagnosis.findings import Finding
from calflow.diagnosis.findings import findings as diagnosed_findings
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.replication import confirm as confirmed
from calflow.effects import Effect, effect_ids, effects_by_id, effects_given
from calflow.effects.base import unmet, unusable
from calflow.effects.stated import known_effects
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import Certainty
from calflow.estimation.field_gain import field_results, gainful_field
from calflow.estimation.identifiability import best_subset, correlations, left_open, redundant, wrong_counts
from calflow.estimation.identification import FittedEffects, fit_effects
from calflow.estimation.least_squares import Loss
from calflow.estimation.leverage import Studentised, judged, judged_table
from calflow.estimation.model_tables import (
    FitSummary,
    IdentifySummary,
    calibrated,
    model_tables,
    observation_table,
    placement_table,
)
from calflow.estimation.noise import NoiseSource
from calflow.estimation.parameters import Parameters, mistaken
from calflow.estimation.progress import Advance, Draws, Say, draws, nobody
from calflow.estimation.residual_field import read_field
from calflow.faults import Fault, as_table, corrected, examined
from calflow.faults.base import SET_UP, lines_in_words
from calflow.faults.duplicate import rows_held_by
from calflow.faults.outlier import odd_rows
from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, refuse, refuse_any, run_checks
from calflow.files.tables import (
    DeferredTables,
    Results,
    as_declared,
    missing_columns,
    to_document,
    to_frame,
    write_results,
)
from calflow.files.toml import Confidence, Count, FalseAlarm, Positive, Seed, as_annotated, checked_arguments
from calflow.files.units import METRE
from calflow.files.words import plural
from calflow.files.writing import inside
from calflow.files.written_toml import write_toml
from calflow.measurements.measurements import Measurements
from calflow.measurements.saved import BESIDE_FILE, ROWS_FILE, load_measurements, save_measurements
from calflow.measurements.source import MeasurementSource
from calflow.model import build
from calflow.observations import Observation
from calflow.programs import filtering
from calflow.robot.formats.controller_files import controller_text
from calflow.robot.formats.robot_file import drives
from calflow.robot.robot import Robot
from calflow.run_folder import INPUTS, CalibratedFolder, check_free, load_again, read_calibrated, record_saved
from calflow.sampling.chain import ChainLength
from calflow.sampling.posterior import Posterior
from calflow.sampling.sample import STANDARD, sample
from calflow.study import SeriesSource, Study, StudyFile, WorkflowFile

if TYPE_CHECKING:
    from calflow.reporting.material import Material
    from calflow.reporting.sections.residuals import Plots

OPEN_SHOWN = 6  # most statements of undetermined parameters shown; further ones are counted
IN_PYTHON = "python"  # the name of a calibration made without a study file
AGAIN = "run the study again"
GONE = "the measurements are no longer there: costs are averaged over random poses within the joint limits"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibration(CalibratedModel, RunOutcome):
    """A calibrated robot: its model with estimate, covariance and error model, all results, and their inputs.

    robot is the manufacturer's robot (`model.robot` has base and tool registered to the measurements); request are the
    settings, as of a study file; results are all tables and summaries by their path in a run folder; measured reads the
    original measurements; before is the calibration before diagnose; folder is the run folder from which it was loaded.
    """

    robot: Robot
    request: StudyFile
    measured: Callable[[], Measurements]
    before: Calibration | None = None
    folder: CalibratedFolder | None = None

    @classmethod
    def of(
        cls, robot: Robot, request: StudyFile, results: Results, measured: Callable[[], Measurements]
    ) -> Calibration:
        """Return the calibration restored from the tables of a run folder: the inverse of `results`.

        Raises:
            InputError: the tables belong to another robot, or to an earlier version of calflow.
        """
        given = results.document("identify/summary.json", IdentifySummary).conditions
        model = calibrated(robot, results, given)
        return cls(**_fields(model), robot=robot, request=request, results=results, measured=measured)

    @classmethod
    def load(cls, study_or_run: str | Path, effects: Sequence[type[Effect]] = ()) -> Calibration:
        """Load a calibration from the folder in which it was saved, from a run folder, or from the run of a study.

        effects are the classes of user-defined effects that no installed package provides.

        Raises:
            InputError: there is no calibration yet, its files in the folder were changed since, or one of its effects
                is not defined.
        """
        effects_by_id(effects)
        read = read_calibrated(study_or_run)

        def measured() -> Measurements:
            if (read.folder / INPUTS / BESIDE_FILE).is_file():
                return load_measurements(read.folder / INPUTS, read.robot)
            with TemporaryDirectory() as made:
                return load_again(read.manifest, read.folder, Path(made)).measurements()

        given = read.results.tables
        tables = DeferredTables(tuple(given), lambda name: as_declared(given[name], TABLES[name]))
        results = Results(tables, read.results.documents)
        return replace(cls.of(read.robot, read.file, results, measured), folder=read)

    def save(self, folder: str | Path) -> Path:
        """Save the calibration without loss as a run folder, which every command accepts, and return it (see `load`).

        Raises:
            InputError: the folder holds the run of a study, which would be overwritten; or measurements are missing.
        """
        folder = Path(folder)
        check_free(folder)
        data, inputs = self.as_given, folder / INPUTS
        inputs.mkdir(parents=True, exist_ok=True)
        asked = {"robot": "robot.toml", "workflow": "workflow.toml", "confirm": ""}
        stages = tuple(dict.fromkeys(name.partition("/")[0] for name in self.results.tables))
        self.robot.to_toml(inputs / "robot.toml")
        write_toml(inside(inputs, "study.toml"), self.request.model_copy(update=asked))
        write_toml(inside(inputs, "workflow.toml"), WorkflowFile(name=self.request.name, stages=stages))
        save_measurements(data, inputs)
        write_results(folder, self.results)
        record_saved(folder, self.robot, self.request, {stage: self.results.of({stage}) for stage in stages}, TABLES)
        return folder

    @cached_property
    def as_given(self) -> Measurements:
        """The original measurements, read once."""
        return self.measured()

    @cached_property
    def data(self) -> Measurements:
        """The measurements used: with gross errors corrected, and the robot registered in the measuring frame."""
        data = corrected(self.as_given, self.results.tables["identify/faults.csv"])
        return data.on(self.model.robot)

    @property
    def diagnosed(self) -> bool:
        """Whether the identified model was diagnosed for missing causes."""
        return "diagnose/effects.csv" in self.results

    @cached_property
    def identified(self) -> Calibration:
        """The calibration before diagnose; itself if it was not diagnosed."""
        if self.before or not self.diagnosed:
            return self.before or self
        before = self.results.of({"identify"})
        return replace(Calibration.of(self.robot, self.request, before, self.measured), folder=self.folder)

    @property
    def title(self) -> str:
        """The title of the calibration."""
        return self.request.title or (
            self.request.name if self.request.name != IN_PYTHON else f"Calibration of {self.robot.name}"
        )

    @property
    def seed(self) -> int:
        """The seed of all random draws."""
        return self.request.seed

    @property
    def source(self) -> MeasurementSource:
        """The source and format of its measurements, those of the first series."""
        return self.request.sources[0]

    @property
    def effects(self) -> tuple[str, ...]:
        """The ids of the model's effects, in order, each cause with the part on which it acts."""
        return tuple(f"{effect.id} {getattr(effect, 'part', '')}".rstrip() for effect in self.model.effects)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on results of the run that the model lacks, which hold for any given rows."""
        return tuple(f"without {what}; {AGAIN}" for what in (self.folder.without if self.folder else ()))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons why the model must not be used, or not yet; empty if it may be used."""
        read = [f"{stage}/{name}.csv" for stage in ("identify", "diagnose") for name in ("accuracy", "residuals")]
        given = self.results.tables
        if older := [name for name in read if name in given and missing_columns(given[name], TABLES[name])]:
            return (
                f"whether the model is to be used cannot be told from {', '.join(older)}, which another version of calflow "
                f"made; {AGAIN}",
            )
        objection = warning(self)
        whole = (fault for fault in self.faults if fault.row == 0 and fault.action == "corrected")
        told = (
            f"Correct the {fault.where}: {fault.statement}"
            if fault.where == SET_UP  # a setting of the device, on which no command depends
            else f"Correct the {fault.where} and run again before this model is used: {fault.statement}, in its measurements "
            "alone; rows are read now, and commands written, as the robot file has them"
            for fault in whole
        )
        return (*(() if objection is None else (objection,)), *dict.fromkeys(told))

    @cached_property
    def parameters(self) -> Parameters:
        """The estimated parameters, by name."""
        return Parameters.of_table(self.fitted_parameters.table, self.robot)

    @property
    def covariance_table(self) -> pd.DataFrame:
        """The covariance of the estimate in SI units, with parameter names as row and column labels."""
        return self.tables[self.path_of("covariance.csv")].set_index("parameter")

    @checked_arguments
    def diagnose(
        self,
        *,
        false_alarm: FalseAlarm = FALSE_ALARM,
        causes: Count = 10,
        catalogue: Sequence[str | type[Effect]] = (),
        leave_out: Sequence[str | type[Effect]] = (),
        confirm: Study | None = None,
        seed: Seed | None = None,
        say: Say = nobody,
        advance: Advance = nobody,
    ) -> Calibration:
        """Return the calibration with missing causes added to the model, and proposed poses to discriminate rivals.

        Args:
            false_alarm: probability of finding any cause where there is none.
            causes: the largest number of causes to add.
            catalogue: effects to search, by id or as classes; all installed ones if it is empty.
            leave_out: effects not to search.
            confirm: the study of an independent series of the same robot, which tests the joint errors found.
            seed: seed of all random draws; None: that of the calibration.
            say: callback for progress messages.
            advance: callback for the completed share of the work.
        """
        before, rng = self.identified, draws(self.seed if seed is None else seed)
        data = before.data
        only, without = (effects_by_id(effects) for effects in (catalogue, leave_out))
        if any(fault.action == "unsettled" for fault in before.faults):
            say("the robot file or the table has a mistake that must be settled first: no cause is named")
            causes = 0
        diagnosis = search_causes(
            before, data, false_alarm=false_alarm, causes=causes, catalogue=only, leave_out=without, rng=rng, say=say,
            advance=advance,
        )  # fmt: skip
        extended = extended_model(diagnosis, before, data)
        asked = {"diagnose": {"false_alarm": false_alarm}}
        tables = _diagnosed_tables(diagnosis, extended, before, questions(diagnosis, data, rng), rng)
        if confirm and diagnosis.causes:
            tables |= _confirmed_tables(diagnosis.extended, confirm, say)
        kept, tables = _completed("diagnose", extended, data, tables, rng, before)
        return Calibration(
            **_fields(kept),
            robot=self.robot, measured=self.measured, folder=self.folder, before=before,
            request=self.request.model_copy(update={"stages": self.request.stages | asked}),
            results=before.results | tables,
        )  # fmt: skip

    @cached_property
    def levels(self) -> Levels:
        """The levels of correction that can be deployed, with remaining errors."""
        return Levels.read(self.model, self.results)

    predict = prediction.predict
    compensate = compensation.compensate
    filter_program = filtering.filter_program
    drift = drift_check.drift
    choose_check_poses = check_poses.choose_check_poses

    @checked_arguments
    def validate(
        self,
        data: Measurements,
        *,
        tolerance: float | None = None,
        task: Count | None = None,
        confidence: Confidence = validation.CONFIDENCE,
        station: Station = "auto",
        sent: Sent | None = None,
    ) -> Validation:
        """Validate the calibrated robot on measurements to which it was not fitted (see `validation.validate`).

        Args:
            data: the new measurements.
            tolerance: largest permitted error of a pose [m, or the unit of the measurements].
            task: number of poses that must all be within the tolerance.
            confidence: probability required for the verdict "met".
            station: whether the device stood in the same place as in the calibration.
            sent: the corrections active in the robot during the measurement; controller figures are those fitted alone.

        Raises:
            InputError: as there; or a verdict is asked on fitted rows.
        """
        judged = validation.validate(
            self,
            data,
            tolerance=tolerance,
            task=task,
            confidence=confidence,
            station=station,
            sent=sent,
            figures=self.levels.figures if sent == "controller figures" else None,
        )
        if judged.summary.tolerance is not None and (lines := self.fitted_lines(data)):
            raise refuse(
                f"{plural(len(lines), 'row')} of {len(data)} ({lines_in_words(lines)}) were fitted and prove nothing; "
                "validate with poses that were measured since, or leave these rows out",
                key="data",
            )
        doubts = [doubt.sentence for doubt in no_better_in_space(self) if judged.summary.unit != METRE.label]
        return replace(judged, summary=replace(judged.summary, notes=(*judged.summary.notes, *doubts)))

    def fitted_lines(self, data: Measurements) -> list[int]:
        """Return the lines of the rows that were fitted; empty if the calibration's measurements are missing."""
        with suppress(InputError):
            before = self.as_given
            return data.table.loc[rows_held_by(before.only(before.train), data), "line"].tolist()
        return []

    @checked_arguments
    def export(self, to: Format, beside: Sequence[str | Path] = ()) -> Export:
        """Return the calibrated robot in a file format; losses of accuracy are means over the measured rows, if any.

        Args:
            to: the format.
            beside: the controller's present files, for formats whose output is pasted into them.

        Raises:
            InputError: the format cannot express the robot's frames, or a controller's file lacks entries to change.
        """
        texts = {Path(path): controller_text(Path(path)) for path in beside}
        model: CalibratedModel = self
        conditions, lost = None, [GONE]
        with suppress(InputError):
            data, lost = self.data, []
            model, conditions = self.later(data.given), data.conditions
        moved_by = drives(self.folder.folder / INPUTS / "robot.toml") if self.folder else None
        exported = exporting.export(
            model, to, self.levels, conditions=conditions, maker=self.robot, drives=moved_by, beside=texts
        )
        return replace(exported, notes=(*lost, *exported.notes))

    @checked_arguments
    def with_residual_field(self, *, seed: Seed | None = None, say: Say = nobody) -> Calibration:
        """Return the calibration with a residual field, a smooth, non-physical correction fitted to training residuals.

        The field is left out if it gains nothing at training poses held out of its fit.

        Args:
            seed: seed of all random draws; None: that of the calibration.
            say: callback for the message whether the field is applied, and its gain.
        """
        bare = replace(self, field=None)
        field, gain = gainful_field(bare, self.data, draws(self.seed if seed is None else seed))
        say(gain.statement)
        results = self.results | field_results(bare, field, gain, self.data)
        field = read_field(results, bare.model.robot)  # bitwise equal to the field of a loaded calibration
        request = self.request.model_copy(update={"residual_field": True})
        return replace(bare, field=field, results=results, request=request)

    @checked_arguments
    def sample(
        self,
        *,
        ess: int = STANDARD.ess,
        max_steps: int = STANDARD.max_steps,
        ensembles: int = STANDARD.ensembles,
        walkers: int | None = STANDARD.walkers,
        block: int = STANDARD.block,
        independent: float = STANDARD.independent,
        seed: Seed | None = None,
        say: Say = nobody,
    ) -> Posterior:
        """Return samples of the parameters' posterior distribution.

        Args:
            ess: effective sample size of every parameter at which sampling stops.
            max_steps: largest number of steps (for this and the next arguments see `ChainLength`).
            ensembles: number of independent ensembles of walkers.
            walkers: number of walkers of each ensemble; None: twice the number of dimensions.
            block: number of steps between two checks of convergence.
            independent: share of steps with the independence proposal.
            seed: seed of all random draws; None: that of the calibration.
            say: callback for progress messages.

        Raises:
            InputError: an argument is out of its bounds, or the walkers are too few.
        """
        seed = self.seed if seed is None else seed
        length = {"ess": ess, "max_steps": max_steps, "ensembles": ensembles, "walkers": walkers, "block": block}
        wanted = ChainLength(**as_annotated(ChainLength, length | {"independent": independent}))
        with TemporaryDirectory() as folder:
            return sample(self, self.data, Path(folder) / "chain.h5", wanted, rng=draws(seed), say=say)

    @checked_arguments
    def select(
        self,
        number: Count = 60,
        *,
        aim: Aim = "parameters",
        task: Task | None = None,
        tolerance: Positive | None = None,
        payload: str = "",
        marker: str = "",
        region: Region | None = None,
        cell: Cell | None = None,
        candidates: Count = 2000,
        stated: Readings | None = None,
        there: Conditions | None = None,
        refine: bool = False,
        order: Order = "short",
        drift: Positive = USUAL_DRIFT,
        seed: Seed | None = None,
        say: Say = nobody,
    ) -> Selection:
        """Return optimal poses for estimating its parameters, to be measured like its first series.

        Effects of approach or travel are not in the design; each joint is approached from both sides equally often.

        Args:
            number: number of poses; the other arguments, except seed and say, are those of `SelectionRequest`.
            seed: seed of all random draws; None: that of the calibration.
            say: callback for messages on the quality of the selection.

        Raises:
            InputError: hardly any pose satisfies the request.
        """
        planned = Planned.like(self.model.observations[0], self.noise(self.data), 0)
        plain = [effect for effect in self.model.effects if not {"approach", "travel"} & set(effect.needs)]
        model = replace(self.model, effects=tuple(plain), given=(), observations=(planned.observation,))
        sided = len(plain) < len(self.model.effects)
        request = SelectionRequest(
            number=number, aim=aim, task=task, payload=payload, marker=marker, region=region, cell=cell, planned=planned,
            candidates=candidates, stated=stated, there=there, tolerance=tolerance, refine=refine, order=order, drift=drift,
            both_sides=sided,
        )  # fmt: skip
        return select(model, request, rng=draws(self.seed if seed is None else seed), say=say)

    @property
    def plot(self) -> Plots:
        """The plots of the calibration."""
        from calflow.reporting.sections.residuals import Plots

        return Plots(self.material())

    def report(self, path: str | Path) -> Path:
        """Write the report to a path that ends in .pdf or .html, and return the path.

        Raises:
            InputError: the path has another ending.
        """
        path = Path(path)
        if path.suffix.lower() not in (".pdf", ".html"):
            raise refuse("expected a name that ends in .pdf or .html", path)
        from calflow.reporting.document import write_report

        with TemporaryDirectory() as folder:
            write_report(self.material(), Path(folder))
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(Path(folder) / f"report{path.suffix.lower()}", path)
        return path

    def material(self) -> Material:
        """Return the data for its plots and its report."""
        from calflow.reporting.material import Material

        request = self.request.model_copy(update={"title": self.title})
        return Material(
            self.results, self.model.robot, request, self.request.name, self.request.stages, lambda: (self, self.data)
        )

    def __repr__(self) -> str:
        shown = self._accuracy.to_string(index=False)
        return "\n".join((f"Calibration: {' + '.join(self.effects)}", shown, *self._words))

    def _repr_html_(self) -> str:
        words = "".join(f"<li>{escape(line)}</li>" for line in self._words)
        title = f"Calibration: {escape(' + '.join(self.effects))}"
        return f"<b>{title}</b>{self._accuracy.to_html(index=False, float_format='{:.3f}'.format)}<ul>{words}</ul>"

    @property
    def _accuracy(self) -> pd.DataFrame:
        return self.accuracy.table[["model", "split", "n", "mean", "max", "unit"]].round(4)

    @property
    def _words(self) -> list[str]:
        """Lines on faults of the data, findings, parameters at bounds, and undetermined parameters."""
        faults = dict.fromkeys(f"{fault.cause.replace('-', ' ')}: {fault.statement}" for fault in self.faults)
        bound = [parameter.name for parameter, there in zip(self.model.parameters, self.at_bound, strict=True) if there]
        left = [statement.statement for statement in self.statements if statement.kind != "bound"]
        needs = "; ".join(need.columns for need in self.needed) or "nothing beyond joints, payload and marker"
        ended = self.fit_summary
        return [
            *([] if self.diagnosed else faults),
            *self._findings,
            *([] if ended.converged else [f"the fit did not converge ({ended.solver.words})"]),
            f"at bounds: {', '.join(bound) or 'none'}",
            *(left[:OPEN_SHOWN] or ["the data determine every parameter"]),
            *([f"and {len(left) - OPEN_SHOWN} more in statements"] if len(left) > OPEN_SHOWN else []),
            *(["a residual field, which is not physical, is added"] if self.field else []),
            f"a prediction needs: {needs}",
        ]

    @property
    def _findings(self) -> list[str]:
        if not self.diagnosed:
            return []
        unseen = self.diagnosis_summary.unseen
        lines = [f"{finding.status.replace('_', ' ')}: {finding.statement}" for finding in self.findings]
        return lines or [f"nothing was found that the model lacks{f'; {unseen}' if unseen else ''}"]


@checked_arguments
def identify(
    robot: Robot,
    data: Measurements,
    effects: Sequence[str | type[Effect] | Effect] = ("geometry", "joint-compliance"),
    *,
    parameters: Parameters | None = None,
    starts: Count = 3,
    loss: Loss = "linear",
    noise: NoiseSource = "auto",
    seed: Seed = 1,
    title: str = "",
    count: Mapping[str, int] | None = None,
    say: Say = nobody,
    advance: Advance = nobody,
    paths: Sequence[Path] = (),
) -> Calibration:
    """Identify a robot's parameters from measurements, after correcting gross errors in these.

    Args:
        robot: the robot as its manufacturer describes it.
        data: measurements with a split (see `Measurements.split`).
        effects: physical effects of the model, by id, as classes or as objects, in the order in which they are added.
        parameters: fixed values, bounds and priors that replace the defaults (see `Parameters.of`).
        starts: number of starting points of each fit.
        loss: loss function of the squared residuals: linear, soft_l1, cauchy.
        noise: source of the measurement noise.
        seed: seed of all random draws.
        title: title of the calibration.
        count: number of parameters to keep, by effect, for which the best subset is reported.
        say: callback for progress messages, `print` for example.
        advance: callback for the completed share of the work.
        paths: the files of the data, one per series, for messages.

    Raises:
        InputError: robot or measurements lack data that an effect needs, or the measurements are too few.
    """
    if "split" not in data.table:
        raise refuse("say first which poses to hold out: data = data.split(holdout=0.3, seed=1)", key="data")
    given, _ = run_checks(
        partial(_checked_effects, effects, robot, data), partial(_check_counts, count or {}, effects, robot)
    )
    robot = robot if parameters is None else parameters.on(robot, data, _objects(given, robot, data))
    settings = {"identify": {"starts": starts, "loss": loss, "noise": noise}}
    named = effect_ids(given)
    request = StudyFile(
        name=IN_PYTHON, title=title, robot="robot.toml", workflow="workflow.toml", seed=seed, effects=named, stages=settings,
        measurements=SeriesSource(file=ROWS_FILE, kind=data.series[0].kind),
    )  # fmt: skip
    rows, faults = examined(data.on(robot), paths)
    for fault in faults:
        say(fault.summary)
    fitted = fit_effects(
        rows, _objects(given, robot, rows.only(rows.train)), starts=starts, loss=loss, noise=noise, rng=draws(seed),
        say=say, advance=advance, source=paths[0] if paths else None,
    )  # fmt: skip
    results = _identified_tables(fitted, faults)
    if count:
        results |= Results({"identify/count.csv": best_subset(fitted.fit, count)})
    model, results = _completed("identify", fitted.known, fitted.data, results, draws(seed))
    return Calibration(**_fields(model), robot=robot, request=request, results=results, measured=lambda: data.on(robot))


# The methods as functions: `calflow.diagnose`, `calflow.export` and `calflow.report`.
diagnose, export, report = Calibration.diagnose, Calibration.export, Calibration.report


def _fields(model: CalibratedModel) -> dict[str, Any]:
    """Return the fields of a calibrated model by name."""
    return {field.name: getattr(model, field.name) for field in fields(CalibratedModel)}


def _completed(
    stage: str, fitted: CalibratedModel, data: Measurements, results: Results, rng: Draws, before: Calibration | None = None
) -> tuple[CalibratedModel, Results]:  # fmt: skip
    """Return a stage's model as it would be loaded, and its results with its certainty, errors in space and levels of effort.

    before: the calibration that was diagnosed, whose levels hold for the same noise.
    """
    # The discrepancy was rounded, and the covariance has the memory order of one that was loaded, so that sums agree exactly.
    discrepancy = results.document(f"{stage}/summary.json", FitSummary).discrepancy(fitted.model.observations)
    model = replace(fitted, covariance=np.asfortranarray(fitted.covariance), discrepancy=discrepancy)
    certainty = Certainty.of(model, data, results.tables[f"{stage}/residuals.csv"])
    results |= Results(documents={f"{stage}/certainty.json": to_document(certainty)})
    if any(type(observation).in_space is not Observation.in_space for observation in model.model.observations):
        name = " + ".join(dict.fromkeys(effect_ids(model.model.effects)))
        rows = space_rows(model, data, rng("in space"), name)
        if stage == "identify":  # the hand-eye errors do not depend on causes found later
            rows = [*hand_eye_errors(model, data), *rows]
        results |= Results({f"{stage}/{IN_SPACE}": to_frame(rows, SpaceError)} if rows else {})
    alike = before and np.array_equal(model.noise(data).sigma, before.noise(data).sigma)
    return model, results | Levels.of(model, data, before.levels if before and alike else None).kept(stage)


def _objects(effects: Sequence[str | type[Effect] | Effect], robot: Robot, data: Measurements) -> list[str | Effect]:
    """Return the effects with classes instantiated for these rows, so that none is mistaken for another of its id."""
    return [effect if isinstance(effect, str | Effect) else effect.stated(robot, data) for effect in effects]


def _checked_effects(
    effects: Iterable[object], robot: Robot, data: Measurements
) -> tuple[str | type[Effect] | Effect, ...]:
    """Return effects that can be fitted.

    Raises:
        InputError: an effect is unknown, given twice, found by diagnosis alone, or needs data that robot and measurements
            lack; or the robot states a prior of a parameter that does not exist.
    """
    given = effects_given(effects)
    try:
        known_effects(effect_ids(given))
    except ValueError as error:
        raise refuse(str(error), key="effects") from None
    every = build(robot, given).effects
    problems = [
        Problem(f"effect '{effect.id}' {why}; diagnose looks for it")
        for stated, effect in zip(given, every, strict=True)
        if (effect.is_noise() or not isinstance(stated, Effect)) and (why := effect.unstatable())
    ]
    problems += [
        Problem(f"effect '{effect.id}' needs {lacking}")
        for effect in every
        for lacking in unmet(effect.needs, robot, data.given)
    ]
    problems += [Problem(message, key=f"expected[{k + 1}]") for k, message in mistaken(robot, every)]
    refuse_any(problems)
    return given


def _check_counts(count: Mapping[str, int], effects: Iterable[object], robot: Robot) -> None:
    usable = effect_ids(effects_given(effect for effect in effects if not unusable(effect)))
    refuse_any(Problem(message, key=f"count: {effect}") for effect, message in wrong_counts(robot, usable, count))


def _identified_tables(fitted: FittedEffects, faults: tuple[Fault, ...]) -> Results:
    """Return the tables and the summary of identify."""
    fit, observed = fitted.fit, fitted.model.observations
    tables = {
        "identify/faults.csv": as_table(faults, fitted.data),
        "identify/parameters.csv": Parameters.fitted(fit, fit.covariance).table,
        "identify/accuracy.csv": to_frame(fitted.steps, Accuracy),
        "identify/residuals.csv": judged(fit, fitted.data, fitted.noise),
        "identify/identifiability.csv": left_open(fit),
        "identify/correlations.csv": correlations(fit),
        "identify/observations.csv": observation_table(observed),
        "identify/placement.csv": placement_table(fitted.data.robot, observed),
        **model_tables("identify", fitted.known),
    }
    left_out = redundant(fitted.data.robot)
    if len(left_out):
        tables["identify/redundant.csv"] = left_out
    return Results(tables, {"identify/summary.json": to_document(fitted.summary)})


AS_IDENTIFIED = ("parameters", "covariance", "errors", "effects", "residuals", "needed_conditions")


def _diagnosed_tables(
    diagnosis: Diagnosis, extended: CalibratedModel, before: Calibration, asked: Sequence[Question], rng: Draws
) -> Results:
    """Return the tables and the summary of diagnose; before is the calibration that was diagnosed."""
    final, data = diagnosis.final or diagnosis.extended, before.data
    studentised = Studentised.of(final.fit, data, extended.noise(data), final.covariance)
    odd, odd_faults = odd_rows(final.fit, data, studentised)
    odd_table = as_table(odd_faults if diagnosis.final else (), data)
    faults = pd.concat([table for table in (before.faults.table, odd_table) if len(table)] or [odd_table])
    tables = {
        "diagnose/findings.csv": to_frame(
            diagnosed_findings(diagnosis, before, data, faults, rng("resamples")), Finding
        ),
        "diagnose/candidates.csv": candidates_table(diagnosis, data.only(data.train), rng("limits")),
        "diagnose/accuracy.csv": accuracy_table(diagnosis, data, list(before.accuracy)),
        "diagnose/next_poses.csv": poses_table(asked, diagnosis.extended),
        "diagnose/separations.csv": separations_table(asked),
        "diagnose/parameters.csv": Parameters.fitted(final.fit, final.covariance).table,
        "diagnose/models_in_reach.csv": models_table(diagnosis.in_reach),
        "diagnose/cause_probabilities.csv": cause_table(diagnosis.in_reach),
        "diagnose/faults.csv": odd_table,
        "diagnose/residuals.csv": judged_table(final.fit, data, studentised, odd),
        "diagnose/curves.csv": curves(diagnosis.extended, diagnosis.causes, data),
        **model_tables("diagnose", extended),
    }
    summary = diagnosis_summary(diagnosis, before, extended)
    if diagnosis.final is None:
        kept = {field.name: getattr(before.summary, field.name) for field in fields(FitSummary)}
        summary = replace(summary, **kept | {"alternatives": summary.alternatives})
        tables |= {f"diagnose/{name}.csv": before.results.tables[f"identify/{name}.csv"] for name in AS_IDENTIFIED}
    return Results(tables, {"diagnose/summary.json": to_document(summary)})


def _confirmed_tables(fitted: Fitted, other: Study, say: Say) -> Results:
    """Return the tables of the confirmation of joint errors by an independent series, after correcting its faults."""
    data, faults = examined(other.measurements(), other.measurement_paths)
    for fault in faults:
        say(f"{other.name}: {fault.summary}")
    causes, curves, accuracy = confirmed(fitted, data)
    say(f"{other.name}: " + "; ".join(causes["words"].unique()))
    return Results(
        {
            "diagnose/confirmation.csv": causes,
            "diagnose/confirmation_curves.csv": curves,
            "diagnose/confirmation_accuracy.csv": accuracy,
            "diagnose/confirmation_faults.csv": as_table(faults, data),
        }
    )
