"""What was found of every robot of a fleet, in one place: its model with parameters and covariance, and the causes it shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from calflow.diagnosis.findings.tables import FindingRow
from calflow.estimation.calibrated import Identified
from calflow.files.results import Results
from calflow.fleet.fleet import FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.population.common_causes import Shown
from calflow.runs.calibrated_run import CalibratedRun

FINDINGS = "diagnose/findings.csv"


@dataclass(frozen=True, eq=False)
class Collected:
    """A calibrated robot of a type: the best model that there is of it, and the causes that diagnose named."""

    robot: str
    type: str
    known: Identified
    causes: tuple[Shown, ...]


def collected(robot: FleetRobot, folder: FleetFolder) -> Collected:
    """Return what was found of a robot that is calibrated.

    Raises:
        InputError: its run folder was changed since.
    """
    run = CalibratedRun.of(folder.run(robot.name))
    return Collected(robot.name, robot.type.name, run.known(()), tuple(_causes(run.results)))


def _causes(results: Results) -> Iterator[Shown]:
    rows = results.rows(FINDINGS, FindingRow) if FINDINGS in results else []
    for row in rows:
        if row.status in ("named", "one_of"):
            yield Shown(row.cause, row.joint or 0, row.detail, row.estimate, row.sd, row.unit)
