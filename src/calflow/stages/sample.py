"""The stage sample: the posterior of the parameters, by emcee in coordinates whitened by the Laplace approximation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.deployment.compensation import not_known
from calflow.deployment.prediction import as_stated, beyond_limits
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.model_tables import IdentifySummary, calibrated
from calflow.faults import corrected
from calflow.faults.implausible import plausible
from calflow.files.deferred import pd
from calflow.files.problems import Problem, refuse
from calflow.files.tables import Results, to_document
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build, stated
from calflow.observations import observations
from calflow.sampling.posterior import DRAWS_KEPT, ChainSummary, Posterior, PosteriorRow, PredictedError
from calflow.sampling.sample import sample, too_few_walkers
from calflow.sampling.task_points import (
    TaskPoint,
    TaskSummary,
    TaskTolerances,
    point_errors,
    task_summary,
    task_table,
    taught,
)
from calflow.stage_settings import SampleSettings, WorkSettings
from calflow.stages.demand import BYTES, Demand
from calflow.stages.stage import Context, Stage
from calflow.study import Study

# Measured: steps until a chain is long enough; seconds per number of the Jacobian of a walker's residuals; simultaneous
# copies of all draws' predictions, and of the chain.
STEPS_FORESEEN, SECONDS, COPIES, CHAINS = 250, 1.4e-8, 5.0, 6.0
TAUGHT = "no image shows the tool: these are its errors once it is taught on the flange at poses like the measured ones"
REMEDY = "keep fewer poses in the file, or leave the stage out: with so many rows, identify/covariance.csv says as much as a chain"


def _run(context: Context) -> Results:
    """Sample the posterior with independent ensembles until the chain is long enough, and report if it is not."""
    study = context.study
    data = corrected(study.measurements(), context.tables["identify/faults.csv"])
    calibration = calibrated(study.robot, context.results, data.given)
    length: SampleSettings = context.settings
    if wrong := too_few_walkers(length.walkers, len(calibration.with_maps_held()[0].model.parameters) + 1):
        raise refuse(wrong, study.path, key="stages.sample.walkers")
    work = length.task  # its rows are read before sampling, as they may have errors
    rows = _points(context, work, calibration.model, data.only(data.train)) if work else None
    path = context.folder / "sample" / "chain.h5"
    posterior = sample(calibration, data, path, length, rng=context.rng, say=context.say, advance=context.advance)
    tables = {"sample/posterior.csv": posterior.table, "sample/predictive.csv": posterior.predictive}
    documents = {"sample/summary.json": to_document(posterior.summary)}
    if work and rows is not None:
        points, summary = _task(context, work, rows.on(calibration.model.robot), calibration, posterior)
        tables["sample/task.csv"], documents["sample/task_summary.json"] = points, to_document(summary)
    return Results(tables, documents)


def _task(
    context: Context, settings: WorkSettings, task: Measurements, calibration: CalibratedModel, posterior: Posterior
) -> tuple[pd.DataFrame, TaskSummary]:
    """Return the accuracy of the robot at the points of its task, and a summary."""
    acceptance = context.study.file.acceptance
    tolerance = settings.tolerance or (acceptance.tolerance if acceptance else None)
    asked = TaskTolerances(tolerance=tolerance, turn_tolerance=settings.turn_tolerance, in_order=settings.path)
    measured = posterior.data.only(posterior.data.train)
    stated = as_stated(calibration, task, "widen")
    places = taught(stated.calibrated, stated.data, measured)
    errors = point_errors(
        posterior, stated.calibrated, stated.data.conditions, context.rng("task errors"), stated.widened, places
    )
    table = task_table(stated.calibrated, stated.data, measured, errors, asked, places)
    of_tool = [TAUGHT] if places else not_known(stated.calibrated, stated.data.conditions)
    notes = (*stated.notes, *of_tool, *beyond_limits(task))
    return table, task_summary(stated.calibrated, table, errors, asked, notes)


def _points(context: Context, settings: WorkSettings, model: Model, measured: Measurements) -> Measurements:
    """Return the task's rows: every pose with every payload.

    Raises:
        InputError: the file has errors, or hardly any pose reaches the region.
    """
    study = context.study
    if settings.poses:
        path, source = study.path.parent / settings.poses, study.file.sources[0]
        origin = context.results.document("identify/summary.json", IdentifySummary).time_origin_s
        how = {"separator": source.separator, "decimal": source.decimal}
        rows = plausible(Measurements.to_predict(path, model.robot, time_origin=origin, **how), path)
        return _with_payloads(rows, settings.payloads) if settings.payloads else rows
    mass = {"": 0.0} | {name: load.mass or 0.0 for name, load in model.robot.payloads.items()}
    payloads = settings.payloads or (max(dict.fromkeys(measured.table["payload"]), key=lambda name: mass[name]),)
    marker = settings.marker or next(iter(model.robot.markers))
    readings, _ = candidates(model, settings.number, payloads[0], marker, settings.region, context.rng("task"))
    drawn = Measurements.from_arrays(model.robot, readings, None, payload=payloads[0], marker=marker)
    return _with_payloads(drawn, payloads)


def _with_payloads(rows: Measurements, payloads: Sequence[str]) -> Measurements:
    """Return the rows repeated for each of these payloads."""
    tables = [rows.table.assign(payload=payload) for payload in payloads]
    return replace(rows, table=pd.concat(tables, ignore_index=True), payload_stated=True)


def _files(study: Study, settings: SampleSettings) -> tuple[Path, ...]:
    """Return the path of the file of the task's poses, if any."""
    named = settings.task.poses if settings.task else ""
    return (study.path.parent / named,) if named else ()


def _problems(study: Study, settings: SampleSettings, data: Measurements | None) -> list[Problem]:
    """Return problems of unknown names, or of fewer walkers than the study's effects need; causes may need more."""
    message = too_few_walkers(settings.walkers, len(build(study.robot, study.file.effects).parameters) + 1)
    unknown = settings.task.wrong(study.robot) if settings.task else ()
    return [
        *([study.setting_problem("sample", message, "walkers")] if message else []),
        *(study.setting_problem("sample", wrong, "task", key) for wrong, key in unknown),
    ]


def _demand(study: Study, settings: SampleSettings, data: Measurements) -> Demand:
    """Estimate the demand: time for the walkers' residuals, memory for the draws' predictions of all rows."""
    train = data.only(data.train)
    first = np.unique(train.repeated, return_index=True)[1]  # repeats are averaged
    residuals = sum(
        len(seen.units) * int(train.of_series(k)[first].sum()) for k, seen in enumerate(observations(train))
    )
    parameters = len(stated(study.robot, study.file.effects, train).parameters)
    walkers = settings.ensembles * (settings.walkers or 2 * (parameters + 1))
    draws = min(STEPS_FORESEEN, settings.max_steps) * walkers
    chain = CHAINS * BYTES * draws * (parameters + 1)
    return Demand(
        3 * len(data), DRAWS_KEPT, COPIES, SECONDS * draws * residuals * parameters, REMEDY, "coordinates", chain
    )


STAGE = Stage(
    "sample",
    "sample the posterior",
    SampleSettings,
    _run,
    needs=("identify",),
    uses=("diagnose",),
    resumes=("sample/chain.h5",),
    tables={
        "sample/posterior.csv": PosteriorRow,
        "sample/predictive.csv": PredictedError,
        "sample/task.csv": TaskPoint,
    },
    documents={"sample/summary.json": ChainSummary, "sample/task_summary.json": TaskSummary},
    problems=_problems,
    demand=_demand,
    reads=_files,
)
