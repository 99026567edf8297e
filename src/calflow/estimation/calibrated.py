"""What identify and diagnose found, rebuilt from their tables for the stages after them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from calflow.effects import Effect, catalogue
from calflow.effects.cause import Carried, Cause
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import Noise, Source
from calflow.estimation.repeats import stated_noise
from calflow.files.problems import refuse
from calflow.files.tables import Tables
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import Observation
from calflow.observations import catalogue as observation_kinds
from calflow.robot.parts import Base, Vector, vector
from calflow.robot.robot import Robot

MANY = 20  # parameters of one cause, beyond which sampling them would take days and say nothing new


@dataclass(frozen=True)
class SeriesNoise:
    """The noise of a series: sigma of a single row [m] (of one that grows, at no distance), growth [m/m], and its source."""

    sigma: float
    source: Source
    growth: float = 0.0


@dataclass(frozen=True)
class Identified:
    """The fitted model with its estimate, covariance (SI units), each series' noise, and the discrepancy it left [m, rad]."""

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    device: tuple[SeriesNoise, ...]
    discrepancy: float
    rotation_discrepancy: float
    loss: Loss

    @property
    def noise_known(self) -> bool:
        """Whether any series' noise is known apart from the fit."""
        return any(one.source != "estimated" for one in self.device)

    @property
    def sigma(self) -> float:
        """Noise of a single row of the first series [m]."""
        return self.device[0].sigma

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of these rows, from where it was taken."""
        stated = stated_noise(data)
        sigma = stated.sigma.copy()
        for k, one in enumerate(self.device):
            own = data.of_series(k)
            if one.growth:
                sigma[own] = one.sigma + one.growth * data.table["range"].to_numpy()[own]
            elif one.source != "file":
                sigma[own] = one.sigma
        return replace(
            stated, sigma=sigma, sources=tuple(one.source for one in self.device), discrepancy=self.discrepancy,
            rotation_discrepancy=self.rotation_discrepancy,
        )  # fmt: skip


def identified(robot: Robot, tables: Tables, given: tuple[str, ...]) -> Identified:
    """Rebuild the model that identify fitted, for rows with these optional conditions."""
    robot = placed(robot, tables)
    names = tuple(dict.fromkeys(tables["identify/parameters.csv"]["effect"]))
    observed = read_observations(tables["identify/observations.csv"])
    known = tuple(_kind(name)(robot) for name in names if name not in observation_kinds())
    return _read("identify", Model(robot, known, given, observed), tables)


def calibrated(robot: Robot, tables: Tables, given: tuple[str, ...]) -> Identified:
    """Rebuild the best model there is: the one that diagnose extended, else identify's."""
    if "diagnose/effects.csv" not in tables:
        return identified(robot, tables, given)
    robot = placed(robot, tables)
    observed = read_observations(tables["identify/observations.csv"])
    effects = read_effects(tables["diagnose/effects.csv"], robot)
    return _read("diagnose", Model(robot, effects, given, observed), tables)


def time_origin(summary: pd.DataFrame) -> float | None:
    """Return the time_s [s] from which the time of what was fitted counts; None where its time is not known."""
    found = summary.loc[summary["item"] == "time_origin_s", "value"]
    return float(found.iloc[0]) if len(found) else None


def with_maps_held(known: Identified) -> tuple[Identified, tuple[Cause, ...]]:
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
    )
    return lean, tuple(held)


def effect_table(effects: Sequence[Effect]) -> pd.DataFrame:
    """Return a row an effect: its id, its part ("" for all), and the figures that make its variant."""
    rows = []
    for effect in effects:
        whole, part = (effect.effect, effect.part) if isinstance(effect, Cause) else (effect, "")
        rows.append({"effect": whole.id, "part": part, "variant": json.dumps(whole.figures)})
    return pd.DataFrame(rows, columns=["effect", "part", "variant"])


def read_effects(table: pd.DataFrame, robot: Robot) -> tuple[Effect, ...]:
    """Rebuild the effects of a table that `effect_table` wrote."""
    found: list[Effect] = []
    for effect, part, variant in table.fillna("")[["effect", "part", "variant"]].itertuples(index=False):
        whole = _kind(effect)(robot, **{name: _frozen(value) for name, value in json.loads(variant).items()})
        found.append(Cause(robot, whole, part) if part else whole)
    return tuple(found)


def observation_table(observed: Sequence[Observation]) -> pd.DataFrame:
    """Return a row a series: what kind of observation it is, and all that makes it."""
    rows = [(one.id, one.series.name, json.dumps(asdict(one))) for one in observed]
    return pd.DataFrame(rows, columns=["kind", "series", "observation"])


def read_observations(table: pd.DataFrame) -> tuple[Observation, ...]:
    """Rebuild the observations of a table that `observation_table` wrote."""
    rows = table[["kind", "observation"]].astype(str).itertuples(index=False)
    return tuple(TypeAdapter(observation_kinds()[kind]).validate_json(text) for kind, text in rows)


def noise_table(
    noise: Noise, observed: Sequence[Observation], growth: tuple[float, float] | None = None
) -> pd.DataFrame:
    """Return a row a series: the noise of a single row, and where it is from; growth is its floor [m] and slope [m/m]."""
    rows = []
    for k, (source, one) in enumerate(zip(noise.sources, observed, strict=True)):
        sigma, slope = growth or (float(np.sqrt(np.mean(noise.sigma[noise.of_series(k)] ** 2))), 0.0)
        rows.append((one.series.name, one.id, source, 1e3 * sigma, 1e3 * slope))
    return pd.DataFrame(rows, columns=["series", "kind", "source", "sigma_mm", "growth_mm_per_m"])


def _read_noise(table: pd.DataFrame) -> tuple[SeriesNoise, ...]:
    columns = (table["sigma_mm"].to_numpy(float), table["source"], table["growth_mm_per_m"].to_numpy(float))
    return tuple(SeriesNoise(sigma / 1e3, source, growth / 1e3) for sigma, source, growth in zip(*columns, strict=True))


def placed(robot: Robot, tables: Tables) -> Robot:
    """Return the robot with base and markers where identify's errors refer to."""
    placement = tables["identify/placement.csv"].set_index("what")
    if (placement["source"] == "robot file").all():
        return robot
    points = placement[["x_m", "y_m", "z_m"]].to_numpy(dtype=float)
    at = {name: vector(point) for name, point in zip(placement.index, points, strict=True)}
    base = Base(origin=at["base"], rotation=_angles(placement, "base"), known=False)
    markers = {name: replace(marker, point=at[name]) for name, marker in robot.markers.items()}
    tool = None if robot.tool_rotation is None else _angles(placement, "tool")
    return replace(robot, base=base, markers=markers, tool_rotation=tool)


def _read(stage: str, model: Model, tables: Tables) -> Identified:
    parameters = tables[f"{stage}/parameters.csv"]
    names = [parameter.name for parameter in model.parameters]
    if names != list(parameters["parameter"]):
        raise refuse(f"{stage}/parameters.csv does not fit the study's robot and effects; run {stage} again")
    summary = tables[f"{stage}/summary.csv"].set_index("item")["value"]
    return Identified(
        model,
        parameters["estimate"].to_numpy(dtype=float),
        tables[f"{stage}/covariance.csv"].iloc[:, 1:].to_numpy(dtype=float),
        parameters["at_bound"].to_numpy(dtype=bool),
        _read_noise(tables[f"{stage}/noise.csv"]),
        float(summary["discrepancy_mm"]) / 1e3,
        float(summary.get("rotation_discrepancy_mrad", 0.0)) / 1e3,
        summary["loss"],
    )


def _kind(effect: str) -> type[Effect]:
    if effect not in catalogue():
        raise refuse(f"the run has effect '{effect}', which is unknown here: install the package that it came from")
    return catalogue()[effect]


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _angles(placement: pd.DataFrame, what: str) -> Vector:
    return vector(np.deg2rad(placement.loc[[what], ["rx_deg", "ry_deg", "rz_deg"]].to_numpy(dtype=float)[0]))
