"""What was identified of every robot of a fleet, in one place: parameters with their covariance, read from the run folders."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calflow.estimation.parameters import Covariances, FittedParameter
from calflow.files.csv import read_csv
from calflow.files.problems import refuse
from calflow.files.tables import from_frame
from calflow.fleet.fleet import Fleet, FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.outcome import read_outcome


@dataclass(frozen=True)
class RobotEstimate:
    """A robot's parameters, as `parameters.csv` has them, and the covariance of their estimates, shape (n, n), in SI units."""

    robot: str
    type: str
    parameters: tuple[FittedParameter, ...]
    covariance: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names: those of identify are the same for all robots of a type."""
        return tuple(one.parameter for one in self.parameters)

    @property
    def estimate(self) -> np.ndarray:
        """What the fit found, shape (n,) [SI, as each parameter's `unit` says]."""
        return np.array([one.estimate for one in self.parameters])


def collected(
    fleet: Fleet, folder: FleetFolder, stage: Literal["identify", "diagnose"] = "identify"
) -> Iterator[RobotEstimate]:
    """Yield what a stage identified of each robot that is calibrated, in the order of their names.

    Identify's model is the same for all robots of a type; diagnose's has besides what was found of each robot.

    Raises:
        InputError: a table is not there, or is not what the stage writes.
    """
    for robot in fleet.robots:
        outcome = read_outcome(folder.outcome(robot.name))
        if outcome and outcome.status == "calibrated":
            yield _estimate(robot, folder, stage)


def _estimate(robot: FleetRobot, folder: FleetFolder, stage: str) -> RobotEstimate:
    run = folder.run(robot.name)
    parameters, covariance = (f"{stage}/{name}.csv" for name in ("parameters", "covariance"))
    for name in (parameters, covariance):
        if not (run / name).is_file():
            raise refuse("is not there any more; run the fleet again", run / name)
    rows = from_frame(read_csv(run / parameters), FittedParameter, parameters)
    names = [row.parameter for row in rows]
    by_name = {row.parameter: row.of for row in from_frame(read_csv(run / covariance), Covariances, covariance)}
    if set(by_name) != set(names):
        raise refuse(f"has other parameters than {parameters}; run the fleet again", run / covariance)
    matrix = np.array([[by_name[name][other] for other in names] for name in names])
    return RobotEstimate(robot.name, robot.type.name, tuple(rows), matrix.reshape(len(names), len(names)))
