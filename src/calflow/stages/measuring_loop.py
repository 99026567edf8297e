"""The measuring loop of a study: whether the measurements so far suffice, and which poses to measure next."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.design.discrimination import planned_like
from calflow.design.next_poses import (
    CONFIDENCE,
    PRECISION,
    MeasuringVerdict,
    NextStep,
    Status,
    in_mm,
    next_step,
    numbered_on,
)
from calflow.design.planned import Task
from calflow.design.selection import TASK_POSES, select
from calflow.diagnosis.diagnosis import search_causes
from calflow.estimation.identification import fit_effects, too_few_equations
from calflow.estimation.progress import Say, draws, nobody
from calflow.faults import examined
from calflow.files.problems import refuse, refuse_any
from calflow.files.toml import Confidence, Count, checked_arguments
from calflow.measurements.measurements import Measurements
from calflow.model import stated
from calflow.observations import observations
from calflow.stage_settings import DiagnoseSettings, IdentifySettings, SelectSettings
from calflow.stages.select import measured_rows, named_problems, planned_selection, request_of, select_problems
from calflow.study import Study

WHERE_MEASURED = (
    "no task and no region: the tool is judged where it was measured (state [stages.select.task], or a region)"
)


@checked_arguments
def next_poses(
    study: Study, number: Count = 10, tolerance: float | None = None, confidence: Confidence = CONFIDENCE,
    say: Say = nobody,
) -> NextStep:  # fmt: skip
    """Return a verdict on a study's measurements so far, and the poses to measure next; nothing is written.

    Args:
        study: the study with the rows measured so far, if any (see `given_rows.with_rows`).
        number: number of poses to propose.
        tolerance: largest permitted error of the tool over the task [m]; None: the study's.
        confidence: probability of meeting the tolerance at which measuring may stop.
        say: callback for progress messages.

    Raises:
        InputError: the study's input has errors, or hardly any pose is left.
    """
    if tolerance is not None and not tolerance > 0:
        raise refuse(f"expected a tolerance above 0, found {1e3 * tolerance:g} mm", key="tolerance")
    settings = study.validated_settings("select", SelectSettings)
    assert isinstance(settings, SelectSettings)
    refuse_any(named_problems(study, settings))
    tolerance = tolerance or settings.tolerance
    unwritten = _missing_files(study)
    if unwritten or not study.file.sources:
        notes = tuple(f"{path} is not there yet" for path in unwritten)
        return _initial_step(study, settings, None, number, tolerance, confidence, notes)
    data = study.measurements()
    train = data.only(data.train)
    model = stated(study.robot, study.file.effects, train, observations(train))
    if too_few := too_few_equations(model, train):
        return _initial_step(study, settings, data, number, tolerance, confidence, (too_few,))
    return _diagnosed_step(study, settings, data, number, tolerance, confidence, say)


def _initial_step(
    study: Study, settings: SelectSettings, data: Measurements | None, number: int, tolerance: float | None, confidence: float,
    notes: tuple[str, ...],
) -> NextStep:  # fmt: skip
    """Return the next step while there are no measurements, or too few to identify anything."""
    refuse_any(select_problems(study, settings, data))
    rng = draws(study.file.seed)
    model, request, _ = planned_selection(study, settings, rng("task"))
    there = None if data is None else measured_rows(data)
    chosen = select(model, replace(request, number=number, there=there), rng=rng)
    status: Status = "nothing measured" if data is None else "too few"
    verdict = MeasuringVerdict(
        status=status, poses=0 if data is None else data.table["pose"].nunique(),
        fitted_poses=0 if data is None else data.table.loc[data.train, "pose"].nunique(),
        measure=request.measure, confidence=confidence, tolerance_mm=in_mm(tolerance), notes=notes,
    )  # fmt: skip
    reason = "surer parameters" if settings.aim == "parameters" else PRECISION
    return NextStep(verdict, numbered_on(chosen.poses.assign(reason=reason), data))


def _diagnosed_step(
    study: Study, settings: SelectSettings, data: Measurements, number: int, tolerance: float | None, confidence: float,
    say: Say,
) -> NextStep:  # fmt: skip
    """Return the next step after identification and diagnosis, which weighs possible missing causes."""
    rng = draws(study.file.seed)
    identifying = study.validated_settings("identify", IdentifySettings)
    assert isinstance(identifying, IdentifySettings)
    data, faults = examined(data, study.measurement_paths)
    for fault in faults:
        say(fault.summary)
    first = fit_effects(
        data, study.file.effects, starts=1, loss=identifying.loss, noise=identifying.noise, rng=rng,
        source=study.measurement_path,
    )  # fmt: skip
    diagnosing = study.validated_settings("diagnose", DiagnoseSettings).model_dump()
    search = search_causes(first.known, first.data, **diagnosing, rng=rng)
    bare = replace(search.extended.model, given=())
    planned = planned_like(search.extended, first.data)
    asked = request_of(study, settings, bare, planned, rng("task"))
    marker = settings.marker or next(iter(study.robot.markers))
    task, notes = asked.task, data.notes
    if task is None and settings.region is not None:
        task = Task.within(bare, (settings.payload,), marker, settings.region, TASK_POSES, rng("task"))
    elif task is None:
        task, notes = _measured(first.data, marker), (*notes, WHERE_MEASURED)
    asked = replace(asked, number=number, marker=marker, task=task, tolerance=tolerance)
    return next_step(search, first.known, replace(first.data, notes=notes), asked, confidence, rng)


def _measured(data: Measurements, marker: str) -> Task:
    """Return the default task: the measured poses, each with its payload."""
    poses = data.only(data.train | data.held_out)
    poses = poses.only(~poses.table.duplicated(["pose", "payload"]).to_numpy())
    carried = poses.table["payload"].astype(str).to_numpy()
    order = np.argsort(carried, kind="stable")
    return Task(poses.joints[order], carried[order], marker)


def _missing_files(study: Study) -> list[Path]:
    """Return the study's measurement files that do not exist yet; empty if the study has further files of rows."""
    sources = study.file.sources if not study.further else ()
    places = [study.path.parent, *([study.data] if study.data else [])]
    return [
        study.path.parent / source.file
        for source in sources
        if not source.url and not any(os.path.lexists(place / source.file) for place in places)
    ]
