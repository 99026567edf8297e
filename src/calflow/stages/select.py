"""The stage select: which poses to measure, by observability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field, field_validator, model_validator

from calflow.design.planned import Planned
from calflow.design.selection import Observability, PlannedPose, select
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.results import Results
from calflow.files.toml import Angle, FileModel, Length, Lengths3, Origin
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base
from calflow.stages.stage import Context, Stage
from calflow.study import Study, known_effects


class SelectSettings(FileModel):
    """Settings of select: how many poses of how many candidates, and where the device can see the tool.

    Poses are chosen for the study's effects and for also_effects, which may be causes to be told apart, and to be measured as
    the series `measure` will be; the study's first one where nothing is said.
    """

    poses: int = Field(default=100, ge=4)
    candidates: int = Field(default=2000, ge=100)
    payload: str = ""
    marker: str = ""
    region_min: Lengths3 | None = None
    region_max: Lengths3 | None = None
    sigma: Length = Field(default=5e-5, gt=0)
    sigma_rotation: Angle = Field(default=1e-4, gt=0)
    measure: str = ""
    also_effects: tuple[str, ...] = ()

    @field_validator("also_effects")
    @classmethod
    def _known(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        return known_effects(effects) if effects else effects

    @model_validator(mode="after")
    def _whole_region(self) -> SelectSettings:
        if self.poses > self.candidates:
            raise ValueError("poses: there must be at least as many candidates")
        if (self.region_min is None) != (self.region_max is None):
            raise ValueError("region_min and region_max go together")
        if (
            self.region_min
            and self.region_max
            and not all(a < b for a, b in zip(self.region_min, self.region_max, strict=True))
        ):
            raise ValueError("region_min must lie below region_max on every axis")
        return self


def run(context: Context) -> Results:
    """Choose poses by D-optimal greedy addition and exchange, and tell what every number of them is worth."""
    study, settings = context.study, context.settings
    if wrong := problems(study, settings, None):
        raise InputError(wrong)
    robot = study.robot if _from_outside(study) else replace(study.robot, base=Base(fixed=True))
    planned = Planned(_planned(study, settings), settings.sigma, settings.sigma_rotation)
    effects = tuple(dict.fromkeys((*study.file.effects, *settings.also_effects)))
    model = build(robot, effects, (), (planned.observation,))
    region = None if settings.region_min is None else np.array([settings.region_min, settings.region_max])
    chosen = select(
        model, settings.poses, payload=settings.payload, marker=settings.marker, region=region, planned=planned,
        of=settings.candidates, rng=context.rng, say=context.say, advance=context.advance,
    )  # fmt: skip
    return Results({"select/poses.csv": chosen.poses, "select/observability.csv": chosen.observability})


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
    for key, name, known in (
        ("marker", settings.marker, study.robot.markers),
        ("payload", settings.payload, study.robot.payloads),
    ):
        if name and name not in known:
            message = f"unknown {key} '{name}'; there are {', '.join(known) or 'none'}{nearest(name, known)}"
            found.append(study.setting_problem("select", message, key))
    return found


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
    tables={"select/poses.csv": PlannedPose, "select/observability.csv": Observability},
    problems=problems,
)
