"""What was found of every robot of a fleet, in one place: its parameters with their covariance, and the causes it shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calflow.diagnosis.findings.finding import Finding
from calflow.estimation.parameters import FittedParameter
from calflow.files.csv import read_csv
from calflow.files.problems import refuse
from calflow.files.tables import from_frame
from calflow.fleet.fleet import FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.population.common_causes import Shown
from calflow.population.likelihood import ParameterEstimates
from calflow.run_folder import Manifest, damage, of_others, read_manifest


@dataclass(frozen=True, eq=False)
class Collected:
    """A calibrated robot of a type: the parameters of the best model that there is of it, and the causes that diagnose named."""

    robot: str
    type: str
    calibration: ParameterEstimates
    causes: tuple[Shown, ...]


def collected(robot: FleetRobot, folder: FleetFolder) -> Collected:
    """Return what was found of a robot that is calibrated, by the three tables that have it: a fleet has hundreds of robots.

    Raises:
        InputError: its run folder was changed since.
    """
    run = folder.run(robot.name)
    manifest = read_manifest(run)
    if manifest is None:
        raise refuse("holds no run any more", run)
    stage = _last_fitted(manifest)
    entry = manifest.stages.get(stage)
    wrong = damage(entry, run) if entry else f"{stage} was never run"
    if wrong:
        raise refuse(f"holds no identified robot: {wrong}; run the fleet again", run)
    placed = frozenset({"base", *robot.type.study.robot.markers})
    causes = tuple(_causes(run / "diagnose/findings.csv")) if stage == "diagnose" else ()
    return Collected(robot.name, robot.type.name, _calibration(run / stage, placed), causes)


def _last_fitted(manifest: Manifest) -> str:
    """The stage that the best model is of."""
    diagnosed = manifest.stages.get("diagnose")
    stands = diagnosed and diagnosed.status == "done" and not of_others(manifest, "diagnose", ["identify"])
    return "diagnose" if stands else "identify"


def _calibration(made: Path, placed: frozenset[str]) -> ParameterEstimates:
    """The parameters in a stage's folder."""
    every = from_frame(read_csv(made / "parameters.csv"), FittedParameter, f"{made.name}/parameters.csv")
    rows = [row for row in every if not row.fixed]
    covariance = read_csv(made / "covariance.csv")
    return ParameterEstimates(
        tuple(row.as_parameter() for row in rows),
        np.array([row.estimate for row in rows]),
        covariance[[row.parameter for row in rows]].to_numpy(dtype=float),
        np.array([row.at_bound for row in rows], dtype=bool),
        placed,
    )


def _causes(findings: Path) -> Iterator[Shown]:
    for row in from_frame(read_csv(findings), Finding, "diagnose/findings.csv"):
        if row.is_cause:
            yield Shown(row.cause, row.joint or 0, row.detail, row.estimate, row.sd, row.unit)
