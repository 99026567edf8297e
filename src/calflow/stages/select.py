"""The stage select: which poses to measure, by observability."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import Field, field_validator, model_validator

from calflow.design.candidates import candidates
from calflow.design.how_many import HowMany
from calflow.design.isolability import Isolability, isolability
from calflow.design.planned import Planned
from calflow.design.selection import Aim, Certificate, Observability, PlannedPose, select
from calflow.design.stated_poses import stated_poses
from calflow.design.task import Task
from calflow.design.told_apart import IsolabilityCell, isolability_gaps, isolability_summary, isolability_table
from calflow.design.visits import Record, Visits
from calflow.diagnosis.search.acceptance import FALSE_ALARM
from calflow.effects import catalogue
from calflow.effects.needs import unmet
from calflow.files.documents import to_document
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.results import Results
from calflow.files.toml import Angle, FileModel, Length, Lengths3, Origin
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import Model, build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base
from calflow.stages.cell_settings import CellSettings
from calflow.stages.stage import Context, Stage
from calflow.study import Study, known_effects

SAID = 5  # gaps in words


class Region(FileModel):
    """A box in the measuring frame."""

    region_min: Lengths3 | None = Field(
        default=None,
        description="least x, y and z of a box in the measuring frame that the marker must be in, e.g. `region_min_mm`",
    )
    region_max: Lengths3 | None = Field(
        default=None, description="largest x, y and z of that box, e.g. `region_max_mm`"
    )

    @model_validator(mode="after")
    def _whole_region(self) -> Region:
        if (self.region_min is None) != (self.region_max is None):
            raise ValueError("region_min and region_max go together")
        if (
            self.region_min
            and self.region_max
            and not all(a < b for a, b in zip(self.region_min, self.region_max, strict=True))
        ):
            raise ValueError("region_min must lie below region_max on every axis")
        return self

    @property
    def region(self) -> np.ndarray | None:
        """The box (2, 3) [m]; None where there is none."""
        return None if self.region_min is None else np.array([self.region_min, self.region_max])


class TaskSettings(Region):
    """The table `[stages.select.task]`: where the robot will work, and what it will carry there.

    Without a region of its own the task is where the poses are measured.
    """

    payloads: tuple[str, ...] = Field(
        default=(), description='what the robot will carry, "" for nothing; that of the poses'
    )
    poses: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) of the task, in the place of poses drawn in the region",
    )
    number: int = Field(default=400, ge=10, description="poses that are drawn in the region")


class SelectSettings(Region):
    """Settings of select: how many poses of how many candidates, what for, and where the device can see the tool.

    Poses are chosen for the study's effects and for also_effects, which may be causes to be told apart, and to be measured as
    the series `measure` will be; the study's first one where nothing is said.
    """

    poses: int = Field(default=100, ge=4, description="how many poses to choose")
    candidates: int = Field(default=2000, ge=100, description="how many to choose them of")
    candidates_file: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) to choose of, such as taught poses, in the place of drawn ones; "
        "those beyond joint limits or outside the region, or that the cell refuses, are left out",
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the tool's standard deviation over the task (root mean square) for which the number of poses is looked "
        "for, e.g. `tolerance_um`",
    )
    refine: bool = Field(
        default=False,
        description="`true`: the poses chosen are moved between the candidates, within joint limits, region and cell; not taught "
        "poses, and not for the `worst`",
    )
    add_to_measured: bool = Field(
        default=False,
        description="`true`: the poses of the study's measurements count as already there (those to be fitted, repeats once), and "
        "`poses` are chosen that add the most to them",
    )
    criterion: Aim | None = Field(
        default=None,
        description="what the poses are to make sure: all `parameters` alike (D-optimal, O1), the `tool` over the task (root mean "
        "square of its error), or where in the task it is `worst`; the tool where there is a task, else the parameters",
    )
    task: TaskSettings | None = Field(default=None, description="a table: where the tool must be right, see below")
    cell: CellSettings | None = Field(default=None, description="a table: what the poses must keep to, see below")
    payload: str = Field(default="", description="what the robot carries while it is measured")
    marker: str = Field(default="", description="what is measured; the first")
    sigma: Length = Field(
        default=5e-5, gt=0, description="standard deviation of the device, per axis, e.g. `sigma_um` (50 µm)"
    )
    sigma_rotation: Angle = Field(
        default=1e-4, gt=0, description="the same of orientations, e.g. `sigma_rotation_mrad` (0.1 mrad)"
    )
    measure: str = Field(default="", description="name of the series as which poses will be measured; the first")
    also_effects: tuple[str, ...] = Field(
        default=(),
        description="causes that are only suspected: the poses are to tell of them as of the study's effects",
    )

    isolability: bool = Field(
        default=False,
        description="`true`: which causes of the catalogue the planned poses would show, and tell from which others, is said in "
        "`select/isolability.csv`, with what could be added to the plan; it takes some seconds to minutes",
    )
    isolability_size: float = Field(
        default=1.0, gt=0, description="of these causes, in usual sizes (their priors' standard deviations)"
    )
    records: tuple[Record, ...] = Field(
        default=("approach",),
        description="what will be recorded of each row besides joint readings: `approach`, `travel`, `time`, `temperature`; for "
        "`isolability`",
    )

    @field_validator("also_effects")
    @classmethod
    def _known(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        return known_effects(effects) if effects else effects

    @model_validator(mode="after")
    def _enough_candidates(self) -> SelectSettings:
        if self.poses > self.candidates and not self.candidates_file:
            raise ValueError("poses: there must be at least as many candidates")
        if self.refine and (self.candidates_file or self.aim == "worst"):
            raise ValueError("refine: taught poses are left as they are, and the criterion must be parameters or tool")
        return self

    @property
    def aim(self) -> Aim:
        """What the poses are to make sure."""
        return self.criterion or ("tool" if self.task else "parameters")


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
