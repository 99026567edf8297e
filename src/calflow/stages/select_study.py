"""What a study says of the poses to be chosen: what is measured, for which task, what was measured already, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calflow.design.planned import Planned, Task, stated_poses
from calflow.design.selection import SelectionRequest
from calflow.design.separability import Record
from calflow.effects import catalogue
from calflow.effects.base import unmet
from calflow.estimation.noise import PerUnit
from calflow.files.problems import Problem, nearest
from calflow.files.toml import Origin
from calflow.files.units import RADIAN, SUFFIXES
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import Model
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.stages.select_settings import SelectSettings
from calflow.study import Study

SIDES: frozenset[Record] = frozenset({"approach", "travel"})  # what vias make known


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
    elif settings.sigma_unit not in ("", *(suffixes := SUFFIXES[observed(study, settings).units[0].dimension])):
        wanted = " or ".join(f"sigma_{unit}" for unit in suffixes)
        found.append(study.setting_problem("select", f"expected the unit of what is measured: {wanted}", "sigma"))
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
        if lacking := unmet(kind.needs, study.robot, tuple(SIDES)):
            yield f"poses cannot be chosen for '{effect}', which needs {lacking[0]}"
        elif not kind(study.robot).declared:
            yield f"'{effect}' has no parameters before there are measurements, so poses cannot be chosen for it"


def task_of(study: Study, settings: SelectSettings, model: Model, rng: np.random.Generator) -> Task | None:
    """Return where the tool must be right; None where the study does not say."""
    task = settings.task
    if task is None:
        return None
    payloads = task.payloads or (settings.payload,)
    marker = settings.marker or next(iter(study.robot.markers))
    if task.poses:
        return Task.of(model, stated_poses(study.path.parent / task.poses, model), payloads, marker)
    region = settings.region if task.region is None else task.region
    return Task.within(model, payloads, marker, region, task.number, rng)


def request_of(
    study: Study, settings: SelectSettings, model: Model, planned: Planned, rng: np.random.Generator
) -> SelectionRequest:
    """Return what a study asks of a selection, where nothing was measured yet: poses, task and what they must keep to."""
    file = settings.candidates_file
    return SelectionRequest(
        number=settings.poses, aim=settings.aim, task=task_of(study, settings, model, rng), payload=settings.payload,
        marker=settings.marker, region=settings.region, cell=settings.cell.of(model.robot) if settings.cell else None,
        planned=planned, candidates=settings.candidates,
        stated=stated_poses(study.path.parent / file, model) if file else None,
    )  # fmt: skip


def measured_rows(data: Measurements) -> np.ndarray:
    """Return the packed conditions of the poses that are fitted, a row a marker and payload of each, without optional ones."""
    own = data.table.loc[data.train].drop_duplicates(["pose", "marker", "payload"]).index
    fixed = data.robot.n_joints + len(data.robot.payloads) + len(data.robot.markers)
    return np.asarray(data.rows[:fixed, data.table.index.get_indexer(own)])


def named_files(study: Study, settings: SelectSettings) -> tuple[Path, ...]:
    """Return the files that settings name, and the measurements where they count."""
    named = (settings.candidates_file, settings.task.poses if settings.task else "")
    measured = study.measurement_paths if settings.add_to_measured else ()
    return (*measured, *(study.path.parent / name for name in named if name))


def _which(study: Study, settings: SelectSettings) -> int:
    """Number of the series as which further poses will be measured."""
    names = [source.name for source in study.file.sources]
    return names.index(settings.measure) if settings.measure else 0


def from_outside(study: Study) -> bool:
    """Return whether anything says where the robot stands."""
    kinds = [study.series(k)[0] for k in range(len(study.file.sources))]
    return not kinds or any(kind.from_outside for kind in kinds)


def observed(study: Study, settings: SelectSettings) -> Observation:
    """Return what is to be measured; positions where the study has no measurements yet."""
    if not study.file.sources:
        return Position.planned(Series())
    kind, series = study.series(_which(study, settings))
    return (kind if series.kind else Position).planned(series)


def planned_of(study: Study, settings: SelectSettings) -> Planned:
    """Return what is to be measured, and how surely."""
    observation = observed(study, settings)
    sigma = settings.sigma or 0.5 * observation.units[0].usual
    return Planned(observation, sigma, PerUnit(((RADIAN, settings.sigma_rotation),)))


def by_sides(effects: Sequence[str]) -> list[str]:
    """Return those of these effects that show by the side from which joints come, and not by where the poses are."""
    return [effect for effect in effects if SIDES & set(catalogue()[effect].needs)]


def _unplaced(study: Study, settings: SelectSettings) -> Problem | None:
    """Say what to state of what is to be measured, where nothing is known of its place."""
    try:
        observed(study, settings)
    except ValueError as error:
        where = (
            ("measurements", _which(study, settings))
            if isinstance(study.file.measurements, tuple)
            else ("measurements",)
        )
        return Origin.of(study.path).problem(f"poses cannot be planned: {error}", *where, "settings")
    return None
