"""The stage select: which poses to measure, by observability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from pydantic import Field, field_validator, model_validator

from calflow.design.candidates import READINGS, candidates, reading_columns, reading_factors
from calflow.design.optimality import exchange, greedy, indices, log_determinant
from calflow.design.planned import Planned
from calflow.estimation.identifiability import NULL
from calflow.files.problems import InputError, Problem, nearest
from calflow.files.results import Results
from calflow.files.tables import column, to_frame, typed
from calflow.files.toml import Angle, FileModel, Length, Lengths3, Origin
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.model import Model, build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base
from calflow.stages.stage import Context, Stage
from calflow.study import Study, known_effects

TASK_POSES = 400  # candidates over which the tool's expected error is averaged


@dataclass(frozen=True, kw_only=True)
class PlannedPose:
    """A chosen pose, in measuring order: joints, the side each comes from, and where the tool will be."""

    pose: int = column("its number in measuring order")
    readings: Mapping[str, float] = column("reading of each joint", "as named", name=READINGS)
    approach: Mapping[str, int] = column(
        "side each joint comes from: -1, +1; 0 at the first pose, which is reached from anywhere",
        name="approach{joint}",
    )
    nominal_x_mm: float = column("where the nominal robot's marker will be, in the measuring frame", "mm")
    nominal_y_mm: float = column("the same along y", "mm")
    nominal_z_mm: float = column("the same along z", "mm")
    marker: str = column("its name")
    payload: str = column("the load; empty: none")


@dataclass(frozen=True, kw_only=True)
class Observability:
    """What a number of poses, the most telling first, is worth."""

    n_poses: int = column("number of poses")
    indices: Mapping[str, float] = column(
        "observability indices O1 to O5, parameters scaled by their priors", name="O{1|2|3|4|5}"
    )
    expected_sd_mm: float = column(
        "root mean square over the workspace of the predicted position's standard deviation", "mm"
    )


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
    marker = settings.marker or next(iter(robot.markers))
    planned = Planned(_planned(study, settings), settings.sigma, settings.sigma_rotation)
    effects = tuple(dict.fromkeys((*study.file.effects, *settings.also_effects)))
    model = build(robot, effects, (), (planned.observation,))
    region = None if settings.region_min is None else np.array([settings.region_min, settings.region_max])
    readings, rows = candidates(
        model, settings.candidates, settings.payload, marker, region, context.rng("candidates"), planned.observation
    )
    whitened = planned.whitened(model, model.nominal, rows) * model.prior_sd
    prior = np.eye(len(model.parameters))
    context.say(f"{len(readings)} candidates, {len(model.parameters)} parameters")

    order = greedy(whitened, prior, settings.poses)
    context.advance(0.3)
    best = exchange(whitened, prior, order)
    context.advance(0.9)
    gained = log_determinant(whitened[best], prior) - log_determinant(whitened[order], prior)
    context.say(f"exchange gained {gained:.3g} in log det over greedy choice")

    travel = _shortest_tour(readings[best])
    chosen = np.array(best)[travel]
    task = model.point_jacobian(model.nominal, rows[:, :TASK_POSES]) * model.prior_sd / settings.sigma
    worth = _observability(whitened, greedy_order(whitened, prior, best), task, settings)
    return Results(
        {
            "select/poses.csv": _poses(model, readings[chosen], rows[:, chosen], settings.payload, marker),
            "select/observability.csv": worth,
        }
    )


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


def greedy_order(whitened: np.ndarray, prior: np.ndarray, chosen: list[int]) -> list[int]:
    """Return the chosen poses, the most telling first."""
    return [chosen[i] for i in greedy(whitened[chosen], prior, len(chosen))]


def _observability(whitened: np.ndarray, order: list[int], task: np.ndarray, settings: SelectSettings) -> pd.DataFrame:
    """Indices and the tool's expected standard deviation against the number of poses.

    Parameters are scaled by their priors, so an index compares what the data say with what was known before. The
    standard deviation is the root mean square over the task's poses of the predicted position's, all three axes.
    """
    n_parameters = whitened.shape[2]
    singular = np.linalg.svd(whitened.reshape(-1, n_parameters), compute_uv=False)
    rank = int((singular > NULL * singular[0]).sum())
    first = -(-rank // 3)
    rows = []
    for n in sorted({*range(first, len(order) + 1, max(1, (len(order) - first) // 30)), len(order)}):
        part = whitened[order[:n]]
        covariance = np.linalg.inv(np.eye(n_parameters) + np.einsum("cai,caj->ij", part, part))
        variance = np.einsum("cai,ij,caj->c", task, covariance, task)
        expected = 1e3 * settings.sigma * np.sqrt(variance.mean())
        own = indices(part.reshape(-1, n_parameters), rank)
        named = {f"O{k}": value for k, value in enumerate(own, start=1)}
        rows.append(Observability(n_poses=n, indices=named, expected_sd_mm=expected))
    return to_frame(rows, Observability)


def _poses(model: Model, readings: np.ndarray, rows: np.ndarray, payload: str, marker: str) -> pd.DataFrame:
    """What a robot programmer needs: joints in measuring order, the side each comes from, and where the tool will be.

    The first pose comes from wherever the robot is, so its approach is 0.
    """
    robot = model.robot
    table: dict[str, object] = {"pose": np.arange(1, len(readings) + 1)}
    table |= dict(zip(reading_columns(robot), np.round(readings * reading_factors(robot), 4).T, strict=True))
    came = np.sign(np.diff(readings, axis=0, prepend=readings[:1])).astype(int)
    for i in range(robot.n_joints):
        table[f"approach{i + 1}"] = came[:, i]
    position = 1e3 * model.position(model.nominal, rows)
    table |= {f"nominal_{axis}_mm": np.round(position[:, i], 1) for i, axis in enumerate("xyz")}
    return typed(pd.DataFrame({**table, "marker": marker, "payload": payload}), PlannedPose)


def _shortest_tour(readings: np.ndarray) -> np.ndarray:
    """Order poses for short travel: nearest neighbour, then 2-opt on the largest joint's motion; shape (n_poses,)."""
    distance = np.abs(readings[:, None] - readings[None]).max(axis=2)
    tour = [0]
    left = set(range(1, len(readings)))
    while left:
        tour.append(min(left, key=lambda j: distance[tour[-1], j]))
        left.remove(tour[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 2):
            for j in range(i + 1, len(tour) - 1):
                before = distance[tour[i - 1], tour[i]] + distance[tour[j], tour[j + 1]]
                after = distance[tour[i - 1], tour[j]] + distance[tour[i], tour[j + 1]]
                if after < before - 1e-9:
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    improved = True
    return np.array(tour)


STAGE = Stage(
    "select",
    "choose the poses to measure",
    SelectSettings,
    run,
    measured=False,
    tables={"select/poses.csv": PlannedPose, "select/observability.csv": Observability},
    problems=problems,
)
