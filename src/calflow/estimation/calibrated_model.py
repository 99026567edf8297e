"""The calibrated model: what predictions and all that builds on them need, and the tables that keep it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from calflow.effects import Effect, effect_class
from calflow.effects.cause import Carried, Cause
from calflow.estimation.fit_summary import FitSummary, IdentifySummary
from calflow.estimation.least_squares import Loss
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.noise import Noise, PerUnit, Source
from calflow.estimation.parameters import FittedParameter
from calflow.estimation.repeats import stated_noise
from calflow.estimation.residual_field import ResidualField, read_field
from calflow.estimation.rival_models import Alternative, AlternativeParameter, CauseInReach, ModelInReach
from calflow.files.problems import refuse
from calflow.files.results import Results
from calflow.files.tables import column, to_frame
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import Observation, observation_kinds
from calflow.robot.frames import vector
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

MANY = 20  # parameters of one cause, beyond which sampling them would take days and say nothing new
ROBOT_FILE, REGISTERED = "robot file", "registered"  # where a place is from
NOT_TURNED = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ModelEffect:
    """An effect of the model, in its order."""

    effect: str = column("its id")
    part: str = column("the part of the robot that it is a cause of; empty: all")
    variant: str = column("the figures that make its variant, as JSON")


@dataclass(frozen=True, kw_only=True)
class ModelObservation:
    """A series of measurements as the model observes it."""

    kind: str = column("id of the observation")
    series: str = column("name of the series; empty: the only one")
    observation: str = column("all that makes it, as JSON")


@dataclass(frozen=True, kw_only=True)
class DeviceNoise:
    """The noise of a series of measurements, as far as one is stated for all its values."""

    series: str = column("its name; empty: the only one")
    kind: str = column("id of its observation")
    source: Source = column("where the noise is known from")
    sigma_mm: float = column(
        "of a single row, per axis; of noise that grows with range, that at no distance; empty: `unit` is another", "mm",
        default=float("nan"),
    )  # fmt: skip
    growth_mm_per_m: float = column("by how much it grows with range", "mm/m", default=0.0)
    typical_mm: float = column(
        "rms over the rows, at the ranges where they were measured, per axis", "mm", default=float("nan")
    )
    unit: str = column("the unit that sigma and typical are in: mm, mrad, px, …", default=METRE.label)
    sigma: float = column("as sigma_mm, in `unit`")
    typical: float = column("as typical_mm, in `unit`")


@dataclass(frozen=True, kw_only=True)
class Placed:
    """Where base, markers, tool and what was observed are that the parameters refer to."""

    what: str = column("base, a marker's name, tool, or what a series observes")
    x_m: float = column("its place: a marker's in the flange's frame, else in the measuring frame", "m")
    y_m: float = column("the same along y", "m")
    z_m: float = column("the same along z", "m")
    rx_deg: float = column("its turn about x, then y, then z", "deg")
    ry_deg: float = column("the same about y", "deg")
    rz_deg: float = column("the same about z", "deg")
    kind: str = column("base, marker, tool or observation")
    source: str = column("who says so: the robot file, or registered by the training data")
    rx_rad: float = column("rx_deg to the last bit", "rad")
    ry_rad: float = column("ry_deg to the last bit", "rad")
    rz_rad: float = column("rz_deg to the last bit", "rad")


@dataclass(frozen=True)
class SeriesNoise:
    """The noise of a series: sigma of a single row (of one that grows, at no distance), growth [m/m], and its source.

    typical is its rms over the rows; where none is given it is sigma. Both are in the series' leading unit.
    """

    sigma: float
    source: Source
    growth: float = 0.0
    typical: float = 0.0

    @property
    def at_rows(self) -> float:
        """Its rms where rows were measured."""
        return self.typical or self.sigma


@dataclass(frozen=True)
class CalibratedModel:
    """The fitted model with its estimate, covariance (SI units), each series' noise, and the discrepancy it left, unit by unit.

    elsewhere [m] is what it errs by beyond all that at poses that it was not fitted to, per axis.

    intraclass is the correlation of what the markers of a standstill err.
    alternatives are other models that explain the data about as well, in_reach all that may be right as well, this one first (none
    where nothing was found); field is a correction beside the model that is not physical.
    needed are the conditions that it must be told of a row, time_origin the reading of the clock from which its times count [s].
    """

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    device: tuple[SeriesNoise, ...]
    discrepancy: PerUnit
    loss: Loss
    elsewhere: float = 0.0
    alternatives: tuple[Alternative, ...] = ()
    field: ResidualField | None = None
    intraclass: float = 0.0
    in_reach: tuple[ModelInReach, ...] = ()
    needed: tuple[NeededCondition, ...] = ()
    time_origin: float | None = None

    @property
    def noise_known(self) -> bool:
        """Whether any series' noise is known apart from the fit."""
        return any(one.source != "estimated" for one in self.device)

    @property
    def sigma(self) -> float:
        """Noise of a single row of the first series [its leading unit]."""
        return self.device[0].sigma

    @property
    def unexplained_length(self) -> float:
        """What positions err by beside parameters and noise, per axis [m], noise in it where that was estimated from the fit."""
        if self.noise_known:
            return self.discrepancy[METRE]
        units = [observation.units[0] for observation in self.model.observations]
        return next((own.at_rows for own, unit in zip(self.device, units, strict=True) if unit == METRE), 0.0)

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of these rows, from where it was taken: of rows that state none, that of the rows which were fitted."""
        stated = stated_noise(data)
        sigma = stated.sigma.copy()
        for k, one in enumerate(self.device):
            own = data.of_series(k)
            if one.growth:
                sigma[own] = one.sigma + one.growth * data.table["range"].to_numpy()[own]
            elif one.source == "file":
                sigma[own] = np.where(np.isnan(sigma[own]), one.at_rows, sigma[own])
            else:
                sigma[own] = one.sigma
            sigma[own & np.isnan(sigma)] = one.at_rows  # rows that do not state theirs, of a device that did
        return replace(
            stated, sigma=sigma, sources=tuple(one.source for one in self.device), discrepancy=self.discrepancy,
            intraclass=self.intraclass,
        )  # fmt: skip


def identified(robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    """Rebuild the model that identify fitted, for rows with these optional conditions."""
    robot = placed(robot, results)
    observed = read_observations(results.rows("identify/observations.csv", ModelObservation))
    effects = read_effects(results.rows("identify/effects.csv", ModelEffect), robot)
    return _read("identify", Model(robot, effects, given, observed), results)


def calibrated(robot: Robot, results: Results, given: tuple[str, ...]) -> CalibratedModel:
    """Rebuild the best model there is: the one that diagnose extended, else identify's; with the residual field if there is one."""
    field = read_field(results, robot)
    if "diagnose/effects.csv" not in results:
        return replace(identified(robot, results, given), field=field)
    robot = placed(robot, results)
    observed = read_observations(results.rows("identify/observations.csv", ModelObservation))
    effects = read_effects(results.rows("diagnose/effects.csv", ModelEffect), robot)
    model = Model(robot, effects, given, observed)
    others = results.rows("diagnose/alternatives.csv", AlternativeParameter)
    reached = _in_reach(results.rows("diagnose/models_in_reach.csv", CauseInReach), robot)
    known = _read("diagnose", model, results)
    return replace(known, alternatives=_alternatives(others, model), field=field, in_reach=reached)


def _alternatives(rows: Sequence[AlternativeParameter], model: Model) -> tuple[Alternative, ...]:
    found = []
    for _, group in groupby(rows, key=lambda row: row.alternative):
        own = list(group)
        first = own[0]
        gone = [effect for effect in model.effects if isinstance(effect, Cause)][first.instead_of - 1]
        rival = [ModelEffect(effect=first.effect, part=first.part, variant=first.variant)] if first.effect else []
        effects = (*(effect for effect in model.effects if effect != gone), *read_effects(rival, model.robot))
        estimate = np.array([row.estimate for row in own])
        found.append(Alternative(replace(model, effects=effects), estimate, first.probability))
    return tuple(found)


def _in_reach(rows: Sequence[CauseInReach], robot: Robot) -> tuple[ModelInReach, ...]:
    found = []
    for _, group in groupby(rows, key=lambda row: row.model):
        own = list(group)
        named = [ModelEffect(effect=row.effect, part=row.part, variant=row.variant) for row in own if row.effect]
        causes = tuple(cause for cause in read_effects(named, robot) if isinstance(cause, Cause))
        first = own[0]
        found.append(ModelInReach(causes, first.change, first.log_prior, first.log_weight, first.independent))
    return tuple(found)


def with_maps_held(known: CalibratedModel) -> tuple[CalibratedModel, tuple[Cause, ...]]:
    """Return the model with causes of very many parameters held at their estimates, and which these are."""
    effects: list[Effect] = []
    kept = [int(i) for observation in known.model.observations for i in known.model.columns(observation)]
    held = []
    for effect in known.model.effects:
        own = known.model.columns(effect)
        if isinstance(effect, Cause) and len(own) > MANY:
            effects.append(Carried(effect.robot, effect, tuple(map(float, known.estimate[own]))))
            held.append(effect)
        else:
            effects.append(effect)
            kept += list(own)
    if not held:
        return known, ()
    rest = np.setdiff1d(np.arange(len(known.estimate)), kept)
    free = rest[~known.at_bound[rest]]
    whole = known.covariance
    given = whole[np.ix_(kept, free)] @ np.linalg.solve(whole[np.ix_(free, free)], whole[np.ix_(free, kept)])
    lean = replace(
        known,
        model=replace(known.model, effects=tuple(effects)),
        estimate=known.estimate[kept],
        covariance=whole[np.ix_(kept, kept)] - given,
        at_bound=known.at_bound[kept],
        alternatives=tuple(one for one in known.alternatives if not set(held) <= set(one.model.effects)),
    )
    return lean, tuple(held)


def effect_table(effects: Sequence[Effect]) -> pd.DataFrame:
    """Return the table of `ModelEffect`s."""
    rows = []
    for effect in effects:
        whole, part = (effect.effect, effect.part) if isinstance(effect, Cause) else (effect, "")
        rows.append(ModelEffect(effect=whole.id, part=part, variant=json.dumps(whole.figures)))
    return to_frame(rows, ModelEffect)


def read_effects(rows: Sequence[ModelEffect], robot: Robot) -> tuple[Effect, ...]:
    """Rebuild the effects that `effect_table` wrote."""
    found: list[Effect] = []
    for row in rows:
        whole = _kind(row.effect)(robot, **{name: _frozen(value) for name, value in json.loads(row.variant).items()})
        found.append(Cause(robot, whole, row.part) if row.part else whole)
    return tuple(found)


def observation_table(observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of `ModelObservation`s."""
    rows = [
        ModelObservation(kind=one.id, series=one.series.name, observation=json.dumps(asdict(one))) for one in observed
    ]
    return to_frame(rows, ModelObservation)


def read_observations(rows: Sequence[ModelObservation]) -> tuple[Observation, ...]:
    """Rebuild the observations that `observation_table` wrote."""
    return tuple(TypeAdapter(observation_kinds()[row.kind]).validate_json(row.observation) for row in rows)


def noise_table(
    noise: Noise, observed: Sequence[Observation], growth: tuple[float, float] | None = None
) -> pd.DataFrame:
    """Return the table of `DeviceNoise`; growth is its floor [m] and slope [m/m]."""
    rows = [
        DeviceNoise(
            series=one.series.name, kind=one.id, source=own.source, growth_mm_per_m=1e3 * own.growth,
            **({"sigma_mm": 1e3 * own.sigma, "typical_mm": 1e3 * own.at_rows} if one.units[0] == METRE else {}),
            unit=one.units[0].label, sigma=one.units[0].shown(own.sigma), typical=one.units[0].shown(own.at_rows),
        )
        for own, one in zip(series_noise(noise, growth), observed, strict=True)
    ]  # fmt: skip
    return to_frame(rows, DeviceNoise)


def series_noise(noise: Noise, growth: tuple[float, float] | None = None) -> tuple[SeriesNoise, ...]:
    """Return the noise of each series; growth is its floor [m] and slope [m/m]."""
    found = []
    for k, source in enumerate(noise.sources):
        typical = float(np.sqrt(np.mean(noise.sigma[noise.of_series(k)] ** 2)))
        sigma, slope = growth or (typical, 0.0)
        found.append(SeriesNoise(sigma, source, slope, typical))
    return tuple(found)


def _read_noise(rows: Sequence[DeviceNoise], observed: Sequence[Observation]) -> tuple[SeriesNoise, ...]:
    scales = [observation.units[0].scale for observation in observed]
    return tuple(
        SeriesNoise(row.sigma / scale, row.source, row.growth_mm_per_m / 1e3, row.typical / scale)
        for row, scale in zip(rows, scales, strict=True)
    )


def placement_table(robot: Robot, observed: Sequence[Observation]) -> pd.DataFrame:
    """Return the table of what is `Placed`: as the robot file says, or registered by the training data."""
    source = ROBOT_FILE if robot.base.known else REGISTERED
    placed = [("base", robot.base.origin, robot.base.rotation, "base", source)]
    placed += [
        (name, marker.point, NOT_TURNED, "marker", source if marker.known else REGISTERED)
        for name, marker in robot.markers.items()
    ]
    if robot.tool_rotation is not None:
        placed.append(("tool", (0.0, 0.0, 0.0), robot.tool_rotation, "tool", source))
    seen = [one for own in observed for one in own.placements]
    placed += [(one.what, one.origin, one.rotation, "observation", REGISTERED) for one in seen]
    rows = []
    for what, (x, y, z), turn, kind, said in placed:
        rx, ry, rz = (float(angle) for angle in np.rad2deg(turn))
        exact = dict(zip(("rx_rad", "ry_rad", "rz_rad"), turn, strict=True))
        rows.append(
            Placed(what=what, x_m=x, y_m=y, z_m=z, rx_deg=rx, ry_deg=ry, rz_deg=rz, kind=kind, source=said, **exact)
        )
    return to_frame(rows, Placed)


def placed(robot: Robot, results: Results) -> Robot:
    """Return the robot with base and markers where identify's errors refer to."""
    observed = read_observations(results.rows("identify/observations.csv", ModelObservation))
    if not any(one.from_outside for one in observed):
        return replace(robot, base=Base(fixed=True))
    rows = results.rows("identify/placement.csv", Placed)
    if all(row.source == ROBOT_FILE for row in rows):
        return robot
    at = {(row.kind, row.what): vector((row.x_m, row.y_m, row.z_m)) for row in rows}  # a marker may be called 'tool'
    turn = {row.kind: vector((row.rx_rad, row.ry_rad, row.rz_rad)) for row in rows}
    base = robot.base if robot.base.known else Base(origin=at["base", "base"], rotation=turn["base"], known=False)
    markers = {name: replace(marker, point=at["marker", name]) for name, marker in robot.markers.items()}
    tool = robot.tool_rotation and turn["tool"]
    return replace(robot, base=base, markers=markers, tool_rotation=tool)


def _read(stage: str, model: Model, results: Results) -> CalibratedModel:
    parameters = [one for one in results.rows(f"{stage}/parameters.csv", FittedParameter) if not one.fixed]
    covariance = results.tables.get(f"{stage}/covariance.csv", pd.DataFrame())
    names = [parameter.name for parameter in model.parameters]
    for name, told in (("parameters", [one.parameter for one in parameters]), ("covariance", list(covariance)[1:])):
        if names != told:
            raise refuse(f"{stage}/{name}.csv does not fit the study's robot and effects; run {stage} again")
    needed = results.rows(f"{stage}/needed_conditions.csv", NeededCondition)
    time_origin = results.document("identify/summary.json", IdentifySummary).time_origin_s
    return CalibratedModel(
        model,
        np.array([one.estimate for one in parameters]),
        covariance.iloc[:, 1:].to_numpy(dtype=float),
        np.array([one.at_bound for one in parameters], dtype=bool),
        **read_error_model(stage, results, model.observations),
        needed=tuple(needed),
        time_origin=time_origin,
    )


def read_error_model(stage: str, results: Results, observed: Sequence[Observation]) -> dict[str, Any]:
    """Return the sizes of the errors as a stage's tables state them, by the fields of `CalibratedModel`.

    Of a figure in mm only so many bits come back as are the same in m: whoever keeps a model in tables goes on with these.
    """
    summary = results.document(f"{stage}/summary.json", FitSummary)
    return {
        "device": _read_noise(results.rows(f"{stage}/noise.csv", DeviceNoise), observed),
        "discrepancy": summary.discrepancy_of(observed),
        "loss": summary.loss,
        "elsewhere": summary.elsewhere_mm / 1e3,
        "intraclass": summary.intraclass,
    }


def _kind(effect: str) -> type[Effect]:
    kind = effect_class(effect)
    if kind is None:
        raise refuse(
            f"the run has effect '{effect}', which is unknown here: install the package that it came from, or define or import "
            "its class before you load it"
        )
    return kind


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
