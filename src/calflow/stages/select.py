"""The stage select: which poses to measure, by observability."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.design.candidates import candidates
from calflow.design.how_many import HowMany
from calflow.design.isolability.isolability import Isolability, isolability
from calflow.design.isolability.told_apart import (
    IsolabilityCell,
    isolability_gaps,
    isolability_summary,
    isolability_table,
)
from calflow.design.isolability.visits import Visits
from calflow.design.planned import Planned
from calflow.design.selection import Certificate, Observability, PlannedPose, select
from calflow.design.stated_poses import stated_poses
from calflow.design.task import Task
from calflow.diagnosis.search.acceptance import FALSE_ALARM
from calflow.effects import catalogue
from calflow.effects.needs import unmet
from calflow.files.documents import to_document
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.results import Results
from calflow.files.toml import Origin
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import Model, build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base
from calflow.stages.select_settings import SelectSettings
from calflow.stages.stage import Context, Stage
from calflow.study import Study

SAID = 5  # gaps in words


def run(context: Context) -> Results:
    """Choose poses by D-optimal greedy addition and exchange, and tell what every number of them is worth."""
    study, settings = context.study, context.settings
    if wrong := problems(study, settings, None):
        raise InputError(wrong)
    robot = study.robot if _from_outside(study) else replace(study.robot, base=Base(fixed=True))
    planned = Planned(_planned(study, settings), settings.sigma, settings.sigma_rotation)
    effects = tuple(dict.fromkeys((*study.file.effects, *settings.also_effects)))
    model = build(robot, effects, (), (planned.observation,))
    task = _task(study, settings, model, context.rng("task"))
    there = _measured(study) if settings.add_to_measured else None
    stated = stated_poses(study.path.parent / settings.candidates_file, model) if settings.candidates_file else None
    chosen = select(
        model, settings.poses, aim=settings.aim, task=task, there=there, stated=stated,
        tolerance=settings.tolerance, refine=settings.refine,
        payload=settings.payload, marker=settings.marker, region=settings.region, planned=planned,
        cell=settings.cell.of(robot) if settings.cell else None,
        of=settings.candidates, rng=context.rng, say=context.say, advance=context.advance,
    )  # fmt: skip
    tables = {"select/poses.csv": chosen.poses, "select/observability.csv": chosen.observability}
    if settings.isolability:
        tables["select/isolability.csv"] = _isolability(context, model, planned, chosen.readings)
    documents = {"select/certificate.json": chosen.certificate, "select/how_many.json": chosen.how_many}
    return Results(tables, {path: to_document(one) for path, one in documents.items()})


def _isolability(context: Context, model: Model, planned: Planned, readings: np.ndarray) -> pd.DataFrame:
    """Say what the poses can tell apart, with and without what could be added to them."""
    study, settings, n = context.study, context.settings, len(readings)
    marker = settings.marker or next(iter(model.robot.markers))
    visits = Visits(model.robot, readings, (settings.payload,) * n, (marker,), frozenset(settings.records))
    more, _ = candidates(
        model, n, settings.payload, marker, settings.region, context.rng("further poses"), planned.observation
    )
    false_alarm = float(study.settings("diagnose").get("false_alarm", FALSE_ALARM))

    def told(of: Visits) -> Isolability:
        rng = context.rng("isolability")  # the same noise each time: what differs is the plan
        return isolability(
            study.file.effects, planned, of, rng, size=settings.isolability_size, false_alarm=false_alarm
        )

    now = told(visits)
    table = isolability_table(
        now, settings.isolability_size, {words: told(added) for words, added in visits.additions(more)}
    )
    context.say(isolability_summary(table))
    gaps = isolability_gaps(table)
    for line in gaps[:SAID]:
        context.say(line)
    if more_gaps := int(table["worst"].sum()) - len(gaps[:SAID]):
        context.say(f"{more_gaps} further gaps are in select/isolability.csv")
    return table


def problems(study: Study, settings: SelectSettings, data: Measurements | None) -> list[Problem]:
    """Find names that robot file and study lack, and what is to be measured and stands nobody knows where."""
    found = []
    names = [source.name for source in study.file.sources]
    if settings.measure and settings.measure not in names:
        named = ", ".join(filter(None, names)) or "none that has a name"
        message = f"unknown measurements '{settings.measure}'; there are {named}{nearest(settings.measure, names)}"
        found.append(study.setting_problem("select", message, "measure"))
    elif said := _unplaced(study, settings):
        found.append(said)
    task = settings.task.payloads if settings.task else ()
    for what, name, known, where in (
        ("marker", settings.marker, study.robot.markers, ("marker",)),
        ("payload", settings.payload, study.robot.payloads, ("payload",)),
        *(("payload", name, study.robot.payloads, ("task", "payloads")) for name in task),
    ):
        if name and name not in known:
            message = f"unknown {what} '{name}'; there are {', '.join(known) or 'none'}{nearest(name, known)}"
            found.append(study.setting_problem("select", message, *where))
    told = settings.cell.wrong(study.robot) if settings.cell else ()
    found += [study.setting_problem("select", message, "cell", key) for message, key in told]
    found += [study.setting_problem("select", message, "also_effects") for message in _untold(study, settings)]
    return found


def _untold(study: Study, settings: SelectSettings) -> Iterator[str]:
    """Say which suspected causes poses alone cannot tell of."""
    for effect in settings.also_effects:
        kind = catalogue()[effect]
        if lacking := unmet(kind.needs, study.robot, ()):
            yield f"poses cannot be chosen for '{effect}', which needs {lacking[0]}"
        elif not kind(study.robot).declared:
            yield f"'{effect}' has no parameters before there are measurements, so poses cannot be chosen for it"


def _task(study: Study, settings: SelectSettings, model: Model, rng: np.random.Generator) -> Task | None:
    """Where the tool must be right; None where the study does not say."""
    task = settings.task
    if task is None:
        return None
    payloads = task.payloads or (settings.payload,)
    marker = settings.marker or next(iter(study.robot.markers))
    if task.poses:
        return Task.of(model, stated_poses(study.path.parent / task.poses, model), payloads, marker)
    region = settings.region if task.region is None else task.region
    return Task.within(model, payloads, marker, region, task.number, rng)


def _measured(study: Study) -> np.ndarray:
    """The packed conditions of the poses that were measured and are fitted, a row a marker and payload of each."""
    data = study.measurements()
    own = data.table.loc[data.train].drop_duplicates(["pose", "marker", "payload"]).index
    fixed = study.robot.n_joints + len(study.robot.payloads) + len(study.robot.markers)
    return np.asarray(data.rows[:fixed, data.table.index.get_indexer(own)])


def _files(study: Study, settings: SelectSettings) -> tuple[Path, ...]:
    """The files that settings name, and the measurements where they count."""
    named = (settings.candidates_file, settings.task.poses if settings.task else "")
    measured = study.measurement_paths if settings.add_to_measured else ()
    return (*measured, *(study.path.parent / name for name in named if name))


def _which(study: Study, settings: SelectSettings) -> int:
    """Number of the series as which further poses will be measured."""
    names = [source.name for source in study.file.sources]
    return names.index(settings.measure) if settings.measure else 0


def _from_outside(study: Study) -> bool:
    """Whether anything says where the robot stands."""
    kinds = [study.series(k)[0] for k in range(len(study.file.sources))]
    return not kinds or any(kind.from_outside for kind in kinds)


def _planned(study: Study, settings: SelectSettings) -> Observation:
    """What is to be measured; positions where the study has no measurements yet."""
    if not study.file.sources:
        return Position.planned(Series())
    kind, series = study.series(_which(study, settings))
    return (kind if series.kind else Position).planned(series)


def _unplaced(study: Study, settings: SelectSettings) -> Problem | None:
    """Say what to state of what is to be measured, where nothing is known of its place."""
    try:
        _planned(study, settings)
    except ValueError as error:
        where = (
            ("measurements", _which(study, settings))
            if isinstance(study.file.measurements, tuple)
            else ("measurements",)
        )
        return Origin.of(study.path).problem(f"poses cannot be planned: {error}", *where, "settings")
    return None


STAGE = Stage(
    "select",
    "choose the poses to measure",
    SelectSettings,
    run,
    measured=False,
    tables={
        "select/poses.csv": PlannedPose,
        "select/observability.csv": Observability,
        "select/isolability.csv": IsolabilityCell,
    },
    documents={"select/certificate.json": Certificate, "select/how_many.json": HowMany},
    problems=problems,
    reads=_files,
)
