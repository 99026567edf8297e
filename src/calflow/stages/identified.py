"""What identify found, rebuilt from its tables for the stages after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.measurements import Measurements
from calflow.model import Model, build
from calflow.problems import refuse
from calflow.robot.description import Base, Marker, Robot
from calflow.stages.fit import Loss
from calflow.stages.noise import Noise, Source
from calflow.stages.stage import Tables


@dataclass(frozen=True)
class Identified:
    """The fitted model with its estimate, covariance (SI units), and the noise and discrepancy it left [m]."""

    model: Model
    estimate: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    sigma: float
    discrepancy: float
    rotation_discrepancy: float
    noise_source: Source
    loss: Loss

    def noise(self, data: Measurements) -> Noise:
        """Return the noise of these rows, from where identify took it."""
        sigma = data.sigma if self.noise_source == "file" else None
        rotation = data.table["sigma_rotation"].to_numpy() if data.rotation is not None else None
        return Noise(
            np.full(len(data), self.sigma) if sigma is None else sigma,
            self.noise_source,
            self.discrepancy,
            rotation,
            self.rotation_discrepancy,
        )


def identified(robot: Robot, tables: Tables, given: tuple[str, ...]) -> Identified:
    """Rebuild the model that identify fitted, for rows with these optional conditions."""
    parameters = tables["identify/parameters.csv"]
    robot = placed(robot, tables)
    model = build(robot, tuple(dict.fromkeys(parameters["effect"])), given)
    names = [parameter.name for parameter in model.parameters]
    if names != list(parameters["parameter"]):
        raise refuse("identify/parameters.csv does not fit the study's robot and effects; run identify again")
    summary = tables["identify/summary.csv"].set_index("item")["value"]
    return Identified(
        model,
        parameters["estimate"].to_numpy(dtype=float),
        tables["identify/covariance.csv"][names].to_numpy(dtype=float),
        parameters["at_bound"].to_numpy(dtype=bool),
        float(summary["sigma_mm"]) / 1e3,
        float(summary["discrepancy_mm"]) / 1e3,
        float(summary.get("rotation_discrepancy_mrad", 0.0)) / 1e3,
        summary["noise_source"],
        summary["loss"],
    )


def placed(robot: Robot, tables: Tables) -> Robot:
    """Return the robot with base and markers where identify's errors refer to."""
    placement = tables["identify/placement.csv"].set_index("what")
    if (placement["source"] == "robot file").all():
        return robot
    points = placement[["x_m", "y_m", "z_m"]].to_numpy(dtype=float)
    at = {name: tuple(float(v) for v in point) for name, point in zip(placement.index, points, strict=True)}
    base = Base.model_construct(origin=at["base"], rotation=_angles(placement, "base"), known=False)
    markers = {name: Marker.model_construct(point=at[name]) for name in robot.markers}
    tool = None if robot.tool_rotation is None else _angles(placement, "tool")
    return robot.model_copy(update={"base": base, "markers": markers, "tool_rotation": tool})


def _angles(placement: pd.DataFrame, what: str) -> tuple[float, float, float]:
    rx, ry, rz = np.deg2rad(placement.loc[[what], ["rx_deg", "ry_deg", "rz_deg"]].to_numpy(dtype=float)[0])
    return float(rx), float(ry), float(rz)
