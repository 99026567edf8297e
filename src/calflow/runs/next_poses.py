"""The measuring loop of a study: what the measurements so far say, whether that is enough, and which poses to measure next."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.design.candidates import allowed, candidates
from calflow.design.discrimination import fitted_share, planned_like, questions, rows_like
from calflow.design.measuring.further_poses import SURER, Chosen, doubts, further_poses
from calflow.design.measuring.lacks import Lacks
from calflow.design.measuring.measuring_verdict import CONFIDENCE, MeasuringVerdict, NextMeasurement, Status, Suspect
from calflow.design.measuring.task_error import Measure, Site, TaskError, task_error
from calflow.design.measuring_order import shortest_tour
from calflow.design.planned import Planned, Task, stated_poses
from calflow.design.selection import TASK_POSES, planned_poses, select
from calflow.design.t_optimality import Choices
from calflow.diagnosis.diagnosis import search_causes
from calflow.diagnosis.findings.extended_model import extended_model
from calflow.diagnosis.findings.tables import Diagnosis, findings
from calflow.diagnosis.findings.verdict import label
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.effects.words import UNEXPLAINED
from calflow.estimation.accuracy import distances, errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.elsewhere import left_out
from calflow.estimation.identification import fit_effects, too_few_equations
from calflow.estimation.progress import Draws, Say, draws, nobody
from calflow.faults import as_table, examined
from calflow.files.problems import InputError, refuse
from calflow.files.results import Results, to_document
from calflow.files.tables import typed
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build, stated
from calflow.observations import observations
from calflow.runs.kept import keep_results
from calflow.stages.diagnose import DiagnoseSettings
from calflow.stages.identify import IdentifySettings
from calflow.stages.select_settings import SelectSettings
from calflow.stages.select_study import by_sides, measured_rows, planned_of, problems, request_of, task_of
from calflow.study import Study

LIKELY = 0.02  # probability from which something suspected is told
TABLES = {"poses.csv": NextMeasurement, "verdict.json": MeasuringVerdict}


@dataclass(frozen=True, eq=False)
class NextStep:
    """The verdict after some measurements, and the poses to measure next, in measuring order: none where it says stop.

    calibrated is the model that the verdict is about; None where there are too few poses to identify one.
    """

    verdict: MeasuringVerdict
    poses: pd.DataFrame
    calibrated: CalibratedModel | None = None

    def write(self, folder: Path) -> None:
        """Write poses.csv and verdict.json, each whole, into a folder of their own.

        Raises:
            InputError: the folder is a run's own, or a stage's.
        """
        results = Results({"poses.csv": self.poses}, {"verdict.json": to_document(self.verdict)})
        keep_results(folder, results, TABLES, "Poses to measure next")


def next_poses(
    study: Study, number: int = 10, tolerance: float | None = None, confidence: float = CONFIDENCE, say: Say = nobody
) -> NextStep:
    """Say what a study's measurements tell so far, and which poses to measure next; nothing is written.

    Args:
        study: with the rows measured so far, if any (see `measured_since.with_rows`).
        number: of poses to propose.
        tolerance: what the tool's error over the task is to be within [m]; the study's, where it is None.
        confidence: the probability of being within it at which measuring may stop.
        say: is told what is done.

    Raises:
        InputError: the study's input is at fault, or hardly any pose is left.
    """
    if number < 1:
        raise refuse(f"expected 1 pose or more, found {number}", key="number")
    if not 0.5 <= confidence < 1:
        raise refuse(f"expected a probability of at least 0.5 and below 1, found {confidence:g}", key="confidence")
    if tolerance is not None and not tolerance > 0:
        raise refuse(f"expected a tolerance above 0, found {1e3 * tolerance:g} mm", key="tolerance")
    settings = study.validated_settings("select", SelectSettings)
    assert isinstance(settings, SelectSettings)
    if wrong := problems(study, settings, None):
        raise InputError(wrong)
    asked = _Asked(study, settings, number, tolerance or settings.tolerance, confidence, say)
    unwritten = _unwritten(study)
    if unwritten or not study.file.sources:
        return asked.begun(None, tuple(f"{path} is not there yet" for path in unwritten))
    data = study.measurements()
    train = data.only(data.train)
    model = stated(study.robot, study.file.effects, train, observations(train))
    if said := too_few_equations(model, train):
        return asked.begun(data, (said,))
    return asked.judged(data)


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is asked of a study."""

    study: Study
    settings: SelectSettings
    number: int
    tolerance: float | None
    confidence: float
    say: Say

    @cached_property
    def rng(self) -> Draws:
        """Draws by the study's seed."""
        return draws(self.study.file.seed)

    @property
    def measure(self) -> Measure:
        """What is compared with the tolerance, as the study's criterion says."""
        return "worst" if self.settings.criterion == "worst" else "rms"

    @property
    def marker(self) -> str:
        """What is measured."""
        return self.settings.marker or next(iter(self.study.robot.markers))

    def task(self, model: Model) -> Task:
        """Return where the tool must be right: where it is measured, if nobody says."""
        rng, settings = self.rng("task"), self.settings
        told = task_of(self.study, settings, model, rng)
        return told or Task.within(model, (settings.payload,), self.marker, settings.region, TASK_POSES, rng)

    def begun(self, data: Measurements | None, notes: tuple[str, ...]) -> NextStep:
        """Propose poses to begin with, or to go on with where there are too few to identify anything."""
        study, settings = self.study, self.settings
        effects = tuple(dict.fromkeys((*study.file.effects, *settings.also_effects)))
        planned = planned_of(study, settings)
        one_sided = by_sides(effects)
        model = build(study.robot, [one for one in effects if one not in one_sided], (), (planned.observation,))
        request = replace(
            request_of(study, settings, model, planned, self.rng("task")), number=self.number,
            there=None if data is None else measured_rows(data),
        )  # fmt: skip
        chosen = select(model, request, rng=self.rng)
        reason = "surer parameters" if settings.aim == "parameters" else SURER
        status: Status = "nothing measured" if data is None else "too few"
        verdict = MeasuringVerdict(
            status=status, poses=0 if data is None else data.table["pose"].nunique(),
            fitted_poses=0 if data is None else data.table.loc[data.train, "pose"].nunique(),
            measure=self.measure, confidence=self.confidence, tolerance_mm=_mm(self.tolerance),
            notes=notes,
        )  # fmt: skip
        return NextStep(verdict, _numbered(chosen.poses.assign(reason=reason), data))

    def judged(self, data: Measurements) -> NextStep:
        """Identify and diagnose, and weigh what may be lacking against the tolerance."""
        study, rng = self.study, self.rng
        identifying = study.validated_settings("identify", IdentifySettings)
        assert isinstance(identifying, IdentifySettings)
        data, faults = examined(data, study.measurement_paths)
        for fault in faults:
            self.say(fault.said)
        first = fit_effects(
            data, study.file.effects, starts=1, loss=identifying.loss, noise=identifying.noise, rng=rng,
            source=study.measurement_path,
        )  # fmt: skip
        data = first.data
        found = search_causes(
            first.known, data, **study.validated_settings("diagnose", DiagnoseSettings).model_dump(), rng=rng
        )
        fitted = found.extended.fitted
        catalogue = Catalogue.of(fitted.data, [effect.id for effect in fitted.plain])
        lacks = Lacks.of(fitted, catalogue)
        bare = replace(fitted.model, given=())
        site = Site.of(fitted, self.task(bare), rng("conditions"))
        alternatives = tuple(one.alternative for one in found.alternatives)
        error = task_error(lacks, alternatives, site, self.measure, rng("task error"))
        verdict = self._verdict(data, found, lacks, catalogue, error)
        calibrated = extended_model(found, first.known, data)
        if verdict.status == "stop":
            return NextStep(verdict, _numbered(_none(study), data), calibrated)
        planned = planned_like(fitted, fitted_share(data))
        choices = self._choices(bare, fitted.data, planned)
        asked = questions(found, data, rng, choices)
        every = doubts(lacks, error, alternatives, site, planned, choices)
        chosen = further_poses(every, asked, choices, self.measure, self.number)
        return NextStep(verdict, _numbered(self._table(bare, choices, chosen, data.given), data), calibrated)

    def _verdict(
        self, data: Measurements, found: Diagnosis, lacks: Lacks, catalogue: Catalogue, error: TaskError
    ) -> MeasuringVerdict:
        fitted, tolerance = found.extended.fitted, self.tolerance
        probability = None if tolerance is None else error.probability(tolerance)
        status: Status = (
            "no tolerance" if probability is None else "stop" if probability >= self.confidence else "measure"
        )
        heldout = data.only(data.held_out)
        outside = distances(errors(fitted.model, fitted.fit.estimate, heldout)) if len(heldout) else None
        lacking = findings(found, data, as_table((), data), self.rng("resamples"))
        return MeasuringVerdict(
            status=status, poses=data.table["pose"].nunique(), fitted_poses=fitted.data.table["pose"].nunique(),
            measure=self.measure, tolerance_mm=_mm(tolerance), confidence=self.confidence, probability=probability,
            probability_at_best=None if tolerance is None else error.within_at_best(tolerance),
            error_mm=_mm(error.quantile(0.5)), error_most_mm=_mm(error.quantile(self.confidence)),
            heldout_rms_mm=None if outside is None else _mm(float(np.sqrt(np.mean(outside**2)))),
            leftout_rms_mm=_mm(left_out(fitted.fit, fitted.poses).rms), elsewhere_mm=_mm(fitted.elsewhere),
            noise_mm=_mm(float(np.sqrt(np.mean(fitted.noise.sigma**2)))), noise_known=fitted.noise.known,
            found=tuple(finding.statement for finding in lacking), suspected=_suspects(found, lacks),
            untested=tuple(sorted(catalogue.lacking)), notes=data.notes,
        )  # fmt: skip

    def _stated(self, model: Model) -> np.ndarray | None:
        file = self.settings.candidates_file
        return stated_poses(self.study.path.parent / file, model) if file else None

    def _choices(self, model: Model, data: Measurements, planned: Planned) -> Choices:
        """Draw poses within cell, region and limits, or take those stated; under the conditions that there were."""
        settings, rng = self.settings, self.rng("candidates")
        cell = settings.cell.of(self.study.robot) if settings.cell else None
        stated_ = self._stated(model)
        if stated_ is None:
            readings, _ = candidates(
                model,
                settings.candidates,
                settings.payload,
                self.marker,
                settings.region,
                rng,
                planned.observation,
                cell,
            )
        else:
            readings = stated_[allowed(model, stated_, settings.payload, self.marker, settings.region, cell)]
        if not len(readings):
            raise refuse(
                "no pose of candidates_file is within limits and region, and allowed by the cell", self.study.path
            )
        came = rng.choice([-1.0, 1.0], readings.shape)
        payloads = (settings.payload,) * len(readings)
        return Choices(readings, came, payloads, rows_like(data, readings, came, payloads, rng).rows)

    def _table(self, model: Model, choices: Choices, chosen: Sequence[Chosen], given: Sequence[str]) -> pd.DataFrame:
        """The poses in short measuring order, each with its reason, and the side it was chosen with where sides were recorded."""
        order = shortest_tour(choices.readings[[one.number for one in chosen]])
        ordered = [chosen[int(k)] for k in order]
        numbers = [one.number for one in ordered]
        table = planned_poses(model, choices.readings[numbers], self.settings.payload, self.marker)
        if "approach" in given:
            sides = choices.approach[numbers].astype(int)
            table = table.assign(**{f"approach{i + 1}": sides[:, i] for i in model.robot.driven})
        return table.assign(reason=[one.reason for one in ordered])


def _unwritten(study: Study) -> list[Path]:
    """The study's measurement files that nobody has written yet, where no rows measured since stand for them."""
    sources = study.file.sources if not study.further else ()
    data = os.environ.get("CALFLOW_DATA")
    places = [study.path.parent, *([Path(data)] if data else [])]
    return [
        study.path.parent / one.file
        for one in sources
        if not one.url and not any(os.path.lexists(place / one.file) for place in places)
    ]


def _suspects(found: Diagnosis, lacks: Lacks) -> tuple[Suspect, ...]:
    """What is suspected, the likeliest first."""
    names = dict.fromkeys((one.form.kind, one.form.name) for one in lacks.every if one.form.kind != "nothing")
    every = [Suspect(name=name, kind=kind, probability=lacks.probability(kind, name)) for kind, name in names]
    every += [
        Suspect(
            name=label(one.rival.id, one.rival.joint) if one.rival else UNEXPLAINED, kind="rival",
            probability=one.probability,
        )
        for one in found.alternatives
    ]  # fmt: skip
    likely = [one for one in every if one.probability >= LIKELY]
    return tuple(sorted(likely, key=lambda one: -one.probability))


def _numbered(table: pd.DataFrame, data: Measurements | None) -> pd.DataFrame:
    """Number poses on from those measured, so that the file may be continued."""
    names = [] if data is None else [str(name) for name in data.table["pose"]]
    last = max((int(name) for name in names if name.isdecimal()), default=0)
    return typed(table.assign(pose=last + np.arange(1, len(table) + 1)), NextMeasurement)


def _none(study: Study) -> pd.DataFrame:
    """A table of poses without any."""
    model = build(study.robot, (), (), ())
    nothing = planned_poses(model, np.zeros((0, study.robot.n_joints)), "", next(iter(study.robot.markers)))
    return nothing.assign(reason="")


def _mm(length: float | None) -> float | None:
    return None if length is None else 1e3 * length
