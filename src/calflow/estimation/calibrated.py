"""What identify and diagnose found, rebuilt from their tables for the stages after them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd

from calflow.effects import Effect, catalogue
from calflow.effects.cause import Carried, Cause
from calflow.estimation.fit import Loss
from calflow.estimation.noise import Noise, Source
from calflow.files.problems import refuse
from calflow.files.tables import Tables
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.robot.parts import Base, Vector, vector
from calflow.robot.robot import Robot

MANY = 20  # parameters of one cause, beyond which sampling them would take days and say nothing new


@dataclass(frozen=True)
class Identified:
    """The fitted model with its estimate, covariance (SI units), and the noise and discrepancy it left [m].

    sigma is that of a single row, of noise that grows with range at no distance; growth is per metre of range.
    """

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    sigma: float
    discrepancy: float
    rotation_discrepancy: float
    noise_source: Source
    loss: Loss
    growth: float = 0.0

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of these rows, from where it was taken."""
        sigma = data.sigma if self.noise_source == "file" and not self.growth else None
        if sigma is None:
            distance = data.table["range"].to_numpy() if self.growth else 0.0
            sigma = np.hypot(np.full(len(data), self.sigma), self.growth * distance)
        rotation = data.table["sigma_rotation"].to_numpy() if data.rotation is not None else None
        return Noise(sigma, self.noise_source, self.discrepancy, rotation, self.rotation_discrepancy)


def identified(robot: Robot, tables: Tables, given: tuple[str, ...]) -> Identified:
    """Rebuild the model that identify fitted, for rows with these optional conditions."""
    robot = placed(robot, tables)
    names = tuple(dict.fromkeys(tables["identify/parameters.csv"]["effect"]))
    return _read("identify", build(robot, names, given), tables)


def calibrated(robot: Robot, tables: Tables, given: tuple[str, ...]) -> Identified:
    """Rebuild the best model there is: the one that diagnose extended, else identify's."""
    if "diagnose/effects.csv" not in tables:
        return identified(robot, tables, given)
    robot = placed(robot, tables)
    return _read("diagnose", Model(robot, read_effects(tables["diagnose/effects.csv"], robot), given), tables)


def with_maps_held(known: Identified) -> tuple[Identified, tuple[Cause, ...]]:
    """Return the model with causes of very many parameters held at their estimates, and which these are."""
    effects: list[Effect] = []
    kept, held, start = [], [], 0
    for effect in known.model.effects:
        own = np.arange(start, start + len(effect.declared))
        start += len(own)
        if isinstance(effect, Cause) and len(own) > MANY:
            effects.append(Carried(effect.robot, effect, tuple(map(float, known.estimate[own]))))
            held.append(effect)
        else:
            effects.append(effect)
            kept += list(own)
    if not held:
        return known, ()
    rest = np.setdiff1d(np.arange(start), kept)
    free = rest[~known.at_bound[rest]]
    whole = known.covariance
    given = whole[np.ix_(kept, free)] @ np.linalg.solve(whole[np.ix_(free, free)], whole[np.ix_(free, kept)])
    lean = replace(
        known,
        model=Model(known.model.robot, tuple(effects), known.model.given),
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
        variant = {field.name: getattr(whole, field.name) for field in fields(whole) if field.name != "robot"}
        rows.append({"effect": whole.id, "part": part, "variant": json.dumps(variant)})
    return pd.DataFrame(rows, columns=["effect", "part", "variant"])


def read_effects(table: pd.DataFrame, robot: Robot) -> tuple[Effect, ...]:
    """Rebuild the effects of a table that `effect_table` wrote."""
    found: list[Effect] = []
    for effect, part, variant in table.fillna("")[["effect", "part", "variant"]].itertuples(index=False):
        whole = catalogue()[effect](robot, **{name: _frozen(value) for name, value in json.loads(variant).items()})
        found.append(Cause(robot, whole, part) if part else whole)
    return tuple(found)


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
        float(summary["sigma_mm"]) / 1e3,
        float(summary["discrepancy_mm"]) / 1e3,
        float(summary.get("rotation_discrepancy_mrad", 0.0)) / 1e3,
        summary["noise_source"],
        summary["loss"],
        float(summary.get("noise_growth_mm_per_m", 0.0)) / 1e3,
    )


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _angles(placement: pd.DataFrame, what: str) -> Vector:
    return vector(np.deg2rad(placement.loc[[what], ["rx_deg", "ry_deg", "rz_deg"]].to_numpy(dtype=float)[0]))
