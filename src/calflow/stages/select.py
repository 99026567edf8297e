"""The stage select: optimal poses to measure, by a request made from the checked settings of a study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calflow.design.candidates import candidates
from calflow.design.isolability import (
    Isolability,
    IsolabilityCell,
    MeasuringPlan,
    isolability,
    isolability_gaps,
    isolability_summary,
)
from calflow.design.measuring_order import DriftPull, drift_words, sides_words
from calflow.design.planned import USUAL_TURNING_SIGMA, Planned, RecordedCondition, SelectionRequest, Task, stated_poses
from calflow.design.selection import Certificate, Observability, PlannedPose, Selection, select
from calflow.design.worth import HowMany, Worth, worth_words
from calflow.diagnosis import FALSE_ALARM
from calflow.effects import catalogue
from calflow.effects.base import unmet
from calflow.estimation.noise import PerUnit
from calflow.files.deferred import pd
from calflow.files.problems import Problem, nearest, refuse_any, unknown_name
from calflow.files.tables import Results, to_document, to_frame
from calflow.files.units import RADIAN, SUFFIXES
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import Model, build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base
from calflow.stage_settings import SelectSettings
from calflow.stages.stage import Context, Stage
from calflow.study import Study

SIDES: frozenset[RecordedCondition] = frozenset({"approach", "travel"})  # conditions determined by via points
MOST_GAPS = 5  # most gaps reported in words


def select_problems(study: Study, settings: SelectSettings, data: Measurements | None) -> list[Problem]:
    """Return problems of unknown names, and of measurements that cannot be planned, e.g. from an unknown place."""
    return [*_unmeasurable(study, settings), *named_problems(study, settings)]


def _unmeasurable(study: Study, settings: SelectSettings) -> list[Problem]:
    """Return the problem because of which the measurements cannot be planned, if any."""
    names = [source.name for source in study.file.sources]
    if settings.measure and settings.measure not in names:
        named = ", ".join(filter(None, names)) or "none that has a name"
        message = f"unknown measurements '{settings.measure}'; there are {named}{nearest(settings.measure, names)}"
        return [study.setting_problem("select", message, "measure")]
    if unplaced := _unplaced(study, settings):
        return [unplaced]
    suffixes = SUFFIXES[observed(study, settings).units[0].dimension]
    message = f"expected the unit of what is measured: {' or '.join(f'sigma_{unit}' for unit in suffixes)}"
    problems = []
    if settings.sigma_unit not in ("", *suffixes):
        problems.append(study.setting_problem("select", message, "sigma"))
    if study.file.sources:
        k = _series_index(study, settings)
        if (unit := study.file.sources[k].sigma_unit) not in ("", *suffixes):
            problems.append(study.source_problem(k, message, f"sigma_{unit}"))
    return problems


def named_problems(study: Study, settings: SelectSettings) -> list[Problem]:
    """Return problems of names unknown to robot file and study, independently of the kind of measurement."""
    problems = []
    task = settings.task.payloads if settings.task else ()
    for what, name, allowed, where in (
        ("marker", settings.marker, study.robot.markers, ("marker",)),
        ("payload", settings.payload, study.robot.payloads, ("payload",)),
        *(("payload", name, study.robot.payloads, ("task", "payloads")) for name in task),
    ):
        if message := unknown_name(what, name, allowed):
            problems.append(study.setting_problem("select", message, *where))
    unfit = settings.cell.wrong(study.robot) if settings.cell else ()
    problems += [study.setting_problem("select", message, "cell", key) for message, key in unfit]
    problems += [study.setting_problem("select", message, "also_effects") for message in _unsuitable(study, settings)]
    return problems


def _unsuitable(study: Study, settings: SelectSettings) -> Iterator[str]:
    """Yield messages on suspected causes that the choice of poses cannot make identifiable."""
    for effect in settings.also_effects:
        kind = catalogue()[effect]
        if lacking := unmet(kind.needs, study.robot, tuple(SIDES)):
            yield f"poses cannot be chosen for '{effect}', which needs {lacking[0]}"
        elif not kind(study.robot).declared:
            yield f"'{effect}' has no parameters before there are measurements, so poses cannot be chosen for it"


def study_task(study: Study, settings: SelectSettings, model: Model, rng: np.random.Generator) -> Task | None:
    """Return the task over which the tool must be accurate; None if the study states none."""
    task = settings.task
    if task is None:
        return None
    payloads = task.payloads or (settings.payload,)
    marker = settings.marker or next(iter(study.robot.markers))
    if task.poses:
        return Task.of(stated_poses(study.path.parent / task.poses, model.robot), payloads, marker)
    region = settings.region if task.region is None else task.region
    return Task.within(model, payloads, marker, region, task.number, rng)


def request_of(
    study: Study, settings: SelectSettings, model: Model, planned: Planned, rng: np.random.Generator
) -> SelectionRequest:
    """Return the study's request for a selection of poses, with its task and constraints, without measured poses."""
    file = settings.candidates_file
    return SelectionRequest(
        number=settings.poses, aim=settings.aim, task=study_task(study, settings, model, rng), payload=settings.payload,
        marker=settings.marker, region=settings.region, cell=settings.cell,
        planned=planned, candidates=settings.candidates,
        stated=stated_poses(study.path.parent / file, model.robot) if file else None,
    )  # fmt: skip


def planned_selection(
    study: Study, settings: SelectSettings, rng: np.random.Generator
) -> tuple[Model, SelectionRequest, list[str]]:
    """Return the model that the poses are to determine before any is measured, the request for them, and the effects that
    are not in the model, since they depend on the side from which joints approach rather than on the poses."""
    robot, planned = study.robot, planned_of(study, settings)
    if not from_outside(study):
        robot = replace(robot, base=Base(fixed=True))
        planned = replace(planned, observation=planned.observation.beside_base())
    effects = list(dict.fromkeys((*study.file.effects, *settings.also_effects)))
    one_sided = [effect for effect in effects if SIDES & set(catalogue()[effect].needs)]
    model = build(robot, [effect for effect in effects if effect not in one_sided], (), (planned.observation,))
    return model, request_of(study, settings, model, planned, rng), one_sided


def measured_rows(data: Measurements) -> np.ndarray:
    """Return the conditions of the training poses without optional ones, a column per pose, marker and payload."""
    measured_rows = data.table.loc[data.train].drop_duplicates(["pose", "marker", "payload"]).index
    fixed = data.robot.n_joints + len(data.robot.payloads) + len(data.robot.markers)
    return np.asarray(data.conditions[:fixed, data.table.index.get_indexer(measured_rows)])


def named_files(study: Study, settings: SelectSettings) -> tuple[Path, ...]:
    """Return the files that the settings name, and the measurement files if the poses are added to these."""
    named = (settings.candidates_file, settings.task.poses if settings.task else "")
    measured = study.measurement_paths if settings.add_to_measured else ()
    return (*measured, *(study.path.parent / name for name in named if name))


def _series_index(study: Study, settings: SelectSettings) -> int:
    """Return the index of the series as which the poses will be measured."""
    names = [source.name for source in study.file.sources]
    return names.index(settings.measure) if settings.measure else 0


def from_outside(study: Study) -> bool:
    """Whether any series is measured from outside, so that it determines the robot's base."""
    kinds = [study.series(k)[0] for k in range(len(study.file.sources))]
    return not kinds or any(kind.from_outside for kind in kinds)


def observed(study: Study, settings: SelectSettings) -> Observation:
    """Return the planned kind of observation; positions if the study has no measurements yet."""
    if not study.file.sources:
        return Position.planned(Series())
    kind, series = study.series(_series_index(study, settings))
    return (kind if series.kind else Position).planned(series)


def planned_of(study: Study, settings: SelectSettings) -> Planned:
    """Return the planned observation with its noise: as the stage states it, else as its series does."""
    observation, sources = observed(study, settings), study.file.sources
    source = sources[_series_index(study, settings)] if sources else None
    sigma = settings.sigma or (source and source.sigma) or 0.5 * observation.units[0].usual
    turning = settings.sigma_rotation or (source and source.sigma_rotation) or USUAL_TURNING_SIGMA
    return Planned(observation, sigma, PerUnit(((RADIAN, turning),)))


def _unplaced(study: Study, settings: SelectSettings) -> Problem | None:
    """Return the problem of settings that planning needs of the series and the study does not state, if any."""
    try:
        observed(study, settings)
    except ValueError as error:
        message = f"poses cannot be planned: {error}; or take a workflow without select, such as diagnose"
        return study.source_problem(_series_index(study, settings), message, "settings")
    return None


def _floor_words(poses: pd.DataFrame, settings: SelectSettings, base: Base) -> list[str]:
    """Return a message on poses below an upright robot's base, if no region, cell or list of poses constrains them."""
    below = int((poses["nominal_z_mm"] < 1e3 * base.origin[2]).sum())
    if settings.region is not None or settings.cell or settings.candidates_file or any(base.rotation[:2]) or not below:
        return []
    return [
        f"{below} of {len(poses)} poses have the marker below the robot's foot: if the floor is there, state region_min_mm and "
        "region_max_mm, or a cell with floor_mm"
    ]


def _run(context: Context) -> Results:
    """Choose poses by D-optimal greedy addition and exchange, and report the worth of every number of poses."""
    study, settings = context.study, context.settings
    refuse_any(select_problems(study, settings, None))
    model, request, one_sided = planned_selection(study, settings, context.rng("task"))
    request = replace(
        request,
        there=measured_rows(study.measurements()) if settings.add_to_measured else None, tolerance=settings.tolerance,
        refine=settings.refine, order=settings.order, drift=settings.drift, both_sides=bool(one_sided),
    )  # fmt: skip
    chosen = select(model, request, rng=context.rng, say=context.say, advance=context.advance)
    for line in (
        *worth_words(chosen.worth),
        *drift_words(chosen.drift),
        *sides_words(chosen.poses, one_sided),
        *_floor_words(chosen.poses, settings, model.robot.base),
    ):
        context.say(line)
    tables = {
        "select/poses.csv": chosen.poses,
        "select/observability.csv": chosen.observability,
        "select/worth.csv": to_frame(chosen.worth, Worth),
        "select/order.csv": to_frame(chosen.drift, DriftPull),
    }
    if settings.isolability:
        tables["select/isolability.csv"] = _isolability(context, model, request.planned, chosen)
    documents = {"select/certificate.json": chosen.certificate, "select/how_many.json": chosen.how_many}
    return Results(tables, {path: to_document(document) for path, document in documents.items()})


def _isolability(context: Context, model: Model, planned: Planned, chosen: Selection) -> pd.DataFrame:
    """Return which causes the poses can isolate, with and without possible additions to the plan."""
    study, settings, n = context.study, context.settings, len(chosen.readings)
    marker = settings.marker or next(iter(model.robot.markers))
    records = frozenset(settings.records) | (frozenset() if chosen.vias is None else SIDES)
    plan = MeasuringPlan(model.robot, chosen.readings, (settings.payload,) * n, (marker,), records, chosen.vias)
    more, _ = candidates(
        model, n, settings.payload, marker, settings.region, context.rng("further poses"), planned.observation
    )
    false_alarm = float(study.settings("diagnose").get("false_alarm", FALSE_ALARM))

    def isolability_of(of: MeasuringPlan) -> Isolability:
        rng = context.rng("isolability")  # the same noise for every plan, so that only the plans differ
        data = of.measurements().split(study.file.split.holdout, study.file.seed)
        return isolability(
            study.file.effects, planned, data, rng, size=settings.isolability_size, false_alarm=false_alarm
        )

    now = isolability_of(plan)
    tried = {words: isolability_of(added) for words, added in plan.additions(more)}
    table = now.table(settings.isolability_size, tried)
    context.say(isolability_summary(table))
    gaps = isolability_gaps(table)
    for line in gaps[:MOST_GAPS]:
        context.say(line)
    if more_gaps := int(table["worst"].sum()) - len(gaps[:MOST_GAPS]):
        context.say(f"{more_gaps} further gaps are in select/isolability.csv")
    return table


STAGE = Stage(
    "select",
    "choose the poses to measure",
    SelectSettings,
    _run,
    measured=False,
    tables={
        "select/poses.csv": PlannedPose,
        "select/observability.csv": Observability,
        "select/worth.csv": Worth,
        "select/order.csv": DriftPull,
        "select/isolability.csv": IsolabilityCell,
    },
    documents={"select/certificate.json": Certificate, "select/how_many.json": HowMany},
    problems=select_problems,
    reads=named_files,
)
