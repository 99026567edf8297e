"""A job of the workflow: some robots, one after the other."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.fleet.attempt import attempt
from calflow.fleet.fleet import Fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.outcome import write_outcome
from calflow.reporting.section import sections
from calflow.runs.cache_key import code_digest


def work(fleet: Fleet, folder: FleetFolder, robots: Sequence[str]) -> None:
    """Calibrate robots and write what came of each; one that fails is tried once more, and holds up no other."""
    sections()  # loaded and worked out before the attempts, which are copies of this process
    code_digest()
    for name in robots:
        robot = fleet.robot(name)
        outcome = attempt(robot, folder)
        if outcome.status == "failed":
            outcome = attempt(robot, folder)
        write_outcome(folder.outcome(name), outcome)
