"""A job of the workflow: some robots, one after the other."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.fleet.attempts import attempts
from calflow.fleet.fleet import Fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.outcome import write_outcome


def work(fleet: Fleet, folder: FleetFolder, names: Sequence[str]) -> None:
    """Calibrate robots and write what came of each; one that fails is tried once more, and holds up no other."""
    failed, minutes = [], fleet.file.fleet.minutes_per_robot
    for outcome in attempts([fleet.robot(name) for name in names], folder, minutes):
        if outcome.status == "failed":
            failed.append(fleet.robot(outcome.robot))
        else:
            write_outcome(folder.outcome(outcome.robot), outcome)
    for outcome in attempts(failed, folder, minutes):
        write_outcome(folder.outcome(outcome.robot), outcome)
