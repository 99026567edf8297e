"""A job of the workflow: some robots, one after the other.

python -m calflow.fleet.work FLEET.toml FOLDER ROBOT ROBOT…
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from calflow.fleet.attempt import attempt
from calflow.fleet.fleet import Fleet, load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.outcome import write_outcome


def work(fleet: Fleet, folder: FleetFolder, robots: Sequence[str]) -> None:
    """Calibrate robots and write what came of each; one that fails is tried once more, and holds up no other."""
    for name in robots:
        robot = fleet.robot(name)
        outcome = attempt(robot, folder)
        if outcome.status == "failed":
            outcome = attempt(robot, folder)
        write_outcome(folder.outcome(name), outcome)


if __name__ == "__main__":
    fleet_file, folder, *robots = sys.argv[1:]
    work(load_fleet(fleet_file), FleetFolder(Path(folder)), robots)
